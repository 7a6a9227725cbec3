"""`tuning.sweep`: how often an axis misses its tolerance over the machines, loads and noise that it may meet."""

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.motion.motion import Motion
from diffdrive.results import Status
from diffdrive.support.atomic_write import remove_temporary
from tuning.progress import Progress, reporting
from tuning.sweeps.engine import Precision, most_in_a_part
from tuning.sweeps.parts import Engine, MachinesDone, Notify, in_process, missing_parts, run_parts
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.result import SweepResult
from tuning.sweeps.room import require_resources
from tuning.sweeps.samples import Method
from tuning.sweeps.summary import ERRORS

PARTS = "parts"  # of a sweep's folder: the machines that were run


def sweep(
    axis: Axis,
    motion: Motion | Sequence[Motion],
    *,
    vary: Mapping[str, str],
    against: Mapping[str, Axis] | None = None,
    machine: Axis | None = None,
    samples: int = 1024,
    tolerance: float | None = None,
    load: float | str = 0.0,
    by: str = "peak_m",
    settle: float = 0.0,
    seed: int = 0,
    method: Method = "sobol",
    precision: Precision = "double",
    out: str | Path | None = None,
    engine: Engine | None = None,
    progress: Progress | None = None,
    throw: bool = False,
) -> SweepResult:
    """Run an axis on many machines, under many loads, with noise of its own each, and say how often it misses.

    With a folder `out` the runs are kept there as they are done; the same call continues an interrupted sweep, and ends
    with the same numbers to the last bit. Method: docs/method/sweeps.md.

    Args:
        axis: The drive and its controller.
        motion: One or several motions, at the axis's rate.
        vary: What differs from machine to machine, a line of text for each quantity: `{"load": "uniform:0..12 kN",
            "plant.mass": "lognormal:3%", "effects.cogging.cosine": "normal:2 N"}`.
        against: Other axes by name, whose controllers are run on the same machines.
        machine: The axis that the machines vary about, where that is not the axis itself.
        samples: Machines.
        tolerance: Of the error `by` (m).
        load: Force on the guides that all bear besides (N).
        by: The error that counts: `peak_m` or `rms_m`.
        settle: From when on errors count (s).
        seed: Of the machines and their noise.
        method: How machines are drawn: `sobol`, `latin-hypercube` or `random`.
        precision: `double`, or `single`.
        out: A folder for the runs.
        engine: Shares the parts out among processes (`tuning.sweeps.workers`, `tuning.sweeps.cluster`).
        progress: Called with (stage, done, of how many).
        throw: Raise an error where a machine diverged.

    Raises:
        ResultError: A machine diverged, with `throw`.
        ParameterError: A sweep that cannot be; names what is wrong.
        MotionError: A motion leaves the axis's limits.

    Examples:
        >>> swept = sweep(axis, lap, vary={"load": "uniform:0..12 kN"}, samples=4096, tolerance=2e-6)
        >>> swept.exceedance(axis.name).interval

    """
    plan = sweep_plan(
        axis, motion, vary=vary, against=against or {}, machine=machine, samples=samples, load=load, settle=settle,
        seed=seed, method=method, precision=precision,
    )  # fmt: skip
    folder = None if out is None else Path(out)
    with reporting(progress) as tell:
        result = run_plan(
            plan, vary, folder, tolerance=tolerance, by=by, engine=engine or in_process,
            done=lambda machines: tell("machines", machines, plan.samples),
        )  # fmt: skip
    if folder is not None:
        result.save(folder)
    return result.require_ok() if throw else result


def require_runnable(plan: SweepPlan, folder: Path | None, *, tolerance: float | None, by: str) -> None:
    """Raise `ParameterError` for a sweep that cannot be run, before anything is written."""
    if by not in ERRORS:
        raise ParameterError(f"by: no error {by!r}; known: {', '.join(ERRORS)}")
    if tolerance is not None and not tolerance > 0.0:
        raise ParameterError(f"tolerance: must be above zero, in m, got {tolerance!r}")
    require_resources(plan, Path(tempfile.gettempdir()) if folder is None else folder)
    if folder is not None:
        missing_parts(plan, folder / PARTS)  # what is there may be of another sweep


def run_plan(
    plan: SweepPlan, vary: Mapping[str, str], folder: Path | None, *, tolerance: float | None, by: str, engine: Engine,
    done: MachinesDone, notify: Notify = lambda _: None,
) -> SweepResult:  # fmt: skip
    """Run the machines of a plan that are not in the folder yet, and say what became of all.

    `vary` are the texts that the plan is made from; `notify` is told what keeps an engine from beginning. Raises
    `ParameterError` for a plan that cannot be run.
    """
    require_runnable(plan, folder, tolerance=tolerance, by=by)
    with parts_folder(folder) as parts:
        rows = run_parts(plan, parts, done, engine, notify)
        order = [("motion", "ascending"), ("controller", "ascending"), ("machine", "ascending")]
        frame = rows.to_table().sort_by(order)
    diverged = int(np.sum(frame["diverged"].to_numpy(zero_copy_only=False)))
    message = "ok" if not diverged else f"{diverged} of {len(frame)} runs diverged"
    status = Status(not diverged, message, code="diverged" if diverged else "ok")
    return SweepResult(frame, plan, dict(vary), tolerance, by, status)


def sweep_plan(
    axis: Axis, motion: Motion | Sequence[Motion], *, vary: Mapping[str, str], against: Mapping[str, Axis],
    machine: Axis | None, samples: int, load: float | str, settle: float, seed: int, method: Method,
    precision: Precision,
) -> SweepPlan:  # fmt: skip
    """The plan of a sweep; raises `ParameterError` and `MotionError` for one that cannot be."""
    if axis.name in against:
        raise ParameterError(f"against: {axis.name!r} is the axis itself; give it another name")
    for name, other in {**against, **({} if machine is None else {"machine": machine})}.items():
        if abs(other.rate / axis.rate - 1.0) > 1e-6:
            raise ParameterError(
                f"{name}: is sampled at {other.rate:g} Hz, the axis at {axis.rate:g} Hz: make them equal"
            )
    several = [motion] if isinstance(motion, Motion) else list(motion)
    names = [each.name for each in several]
    motions = {
        name if names[:k].count(name) == 0 else f"{name} #{names[:k].count(name) + 1}": each
        for k, (name, each) in enumerate(zip(names, several, strict=True))
    }
    believed = axis if machine is None else Axis(
        machine.drive, axis.controller, axis.sampling, axis.limits, axis.mapping, axis.name
    )  # fmt: skip
    controllers = {axis.name: axis.controller} | {name: other.controller for name, other in against.items()}
    texts = tuple(f"{name}={text}" for name, text in vary.items())
    return SweepPlan.of(
        believed, controllers, motions, texts, samples, load=str(load), most_in_a_part=most_in_a_part(),
        settle=settle, seed=seed, method=method, precision=precision,
    )  # fmt: skip


@contextlib.contextmanager
def parts_folder(folder: Path | None) -> Iterator[Path]:
    """Where the parts go: into the folder, or nowhere for long."""
    if folder is not None:
        remove_temporary(folder / PARTS)
        yield folder / PARTS
        return
    with tempfile.TemporaryDirectory(prefix="sweep-") as room:
        yield Path(room)
