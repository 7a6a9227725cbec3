"""What a sweep takes, found before it begins: numbers for its machines, memory for its cycles and results, disk."""

from collections.abc import Iterator
from pathlib import Path

from diffdrive.errors import ParameterError
from diffdrive.support.resources import format_count, require_disk, require_memory
from tuning.sweeps.plan import SweepPlan

# the noise of a machine is drawn from its number, of which the generator takes 32 bits; Sobol's sequence has 30
MAX_MACHINES = {"sobol": 2**30}
MAX_NUMBER = 2**32
NUMBER = 8  # bytes
COLUMNS = 12  # of a row beside what varies, as they lie in memory with their names
ARRAYS = 16  # over the samples of a motion: as it is planned, and as the engine takes it


def require_resources(plan: SweepPlan, folder: Path) -> None:
    """Raise `ParameterError` for a sweep that cannot be held: its results in memory, its parts on the disk of `folder`.

    A big one that fits goes on.
    """
    most = MAX_MACHINES.get(plan.method, MAX_NUMBER)
    if plan.samples > most:
        raise ParameterError(
            f"samples: {format_count(plan.samples)}, and {plan.method} has {most} machines at most; give fewer, or "
            "another method"
        )
    runs = plan.samples * len(plan.controllers) * len(plan.motions)
    row = NUMBER * (COLUMNS + len(plan.varied))
    request = (
        f"samples: {format_count(plan.samples)} machines, {format_count(runs)} runs, whose results are summed up "
        "together,"
    )
    # the rows, and those of one group once more while they are put into their order
    require_memory(ParameterError, request, float(row) * (runs + plan.samples), "give fewer")
    require_disk(
        ParameterError, request, _existing_parent(folder), 0.5 * row * runs, "give fewer, or a folder on another disk"
    )
    samples = sum(len(motion.time) for motion in plan.motions.values())
    require_memory(
        ParameterError,
        f"motions of {format_count(samples)} samples in all",
        float(NUMBER * ARRAYS) * samples,
        "shorten them, or lower sampling.rate",
    )


def _existing_parent(folder: Path) -> Path:
    """The folder, or the nearest one above it that is there."""
    above: Iterator[Path] = iter((folder, *folder.resolve().parents))
    return next(parent for parent in above if parent.is_dir())
