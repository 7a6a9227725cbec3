"""`tuning.sweep`: how often an axis misses its tolerance over the machines, loads and noise that it may meet."""

import contextlib
import logging
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis, require_axis
from diffdrive.errors import ParameterError
from diffdrive.motion.motion import Motion
from diffdrive.motion.text import require_choice
from diffdrive.results import Status
from diffdrive.support.atomic_write import remove_temporary
from tuning.identification.workflow import IdentificationResult
from tuning.progress import Progress, reporting
from tuning.sweeps.engine import Precision
from tuning.sweeps.identified import Distributions, about_identified, about_nominal, read_uncertainty
from tuning.sweeps.notes import convergence_notes, uncertainty_notes
from tuning.sweeps.parts import ComputedParts, Engine, Notify, in_process, missing_parts, run_parts
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.result import SweepResult
from tuning.sweeps.room import require_resources
from tuning.sweeps.samples import Method
from tuning.sweeps.spec import SweepSpec, write_spec
from tuning.sweeps.summary import ERRORS
from tuning.sweeps.varying import all_that_varies

PARTS = "parts"  # of a sweep's folder: the machines that were run

Started = Callable[[SweepPlan, tuple[str, ...]], None]


def sweep(
    axis: Axis,
    motions: Motion | str | Sequence[Motion | str],
    *,
    vary: Mapping[str, str] | None = None,
    spread: str | float | None = None,
    identified: IdentificationResult | str | Path | None = None,
    against: Mapping[str, Axis] | None = None,
    machine: Axis | None = None,
    samples: int = 1024,
    tolerance: float | None = None,
    load: float | str = 0.0,
    by: str = "peak",
    settle: float = 0.5,
    seed: int = 0,
    method: Method = "sobol",
    precision: Precision = "double",
    workers: int | None = None,
    cluster: str | None = None,
    resume: str | Path | None = None,
    out: str | Path | None = None,
    progress: Progress | None = None,
    started: Started = lambda plan, notes: None,
    notify: Notify = logging.getLogger(__name__).warning,
    throw: bool = False,
) -> SweepResult:
    """Run an axis on many machines, under many loads, with noise of its own each, and say how often it misses.

    What varies is what `vary` says, then what an identification left open (`identified`, else the `uncertainty` of the
    axis that the machines vary about), then the `spread` of all other parameters of plant and friction; where there is
    none of these, those parameters vary by 2 %. Method: docs/method/sweeps.md.

    Args:
        axis: The drive and its controller.
        motions: One or several, at the axis's rate: a `Motion`, a file, or a line of text as `diffdrive motions` lists
            (`"sine:amplitude=1mm,frequency=10Hz,duration=1s"`), whose settings may vary, too.
        vary: What differs from machine to machine, a line of text for each quantity: `{"load": "uniform:0..12 kN",
            "plant.mass": "lognormal:3%", "motion.amplitude": "uniform:1..2 mm"}`.
        spread: Relative deviation of all other parameters of plant and friction, such as `"3%"` or 0.03.
        identified: The result of `identify`, or its file uncertainty.toml: what was fitted varies as far as the logs
            left it open about what it found, with its correlations. By default the axis's own `uncertainty` about the
            axis's values.
        against: Other axes by name, whose controllers are run on the same machines.
        machine: The axis that the machines vary about, where that is not the axis itself.
        samples: Machines.
        tolerance: Of the error `by` (m).
        load: Force on the guides that all bear besides (N), or as text a load over time.
        by: The error that counts: `peak` or `rms`.
        settle: From when on errors count (s).
        seed: Of the machines and their noise.
        method: How machines are drawn: `sobol`, `latin-hypercube` or `random`.
        precision: `double`, or `single`.
        workers: Processes of this computer that share the work; by default this process alone.
        cluster: The address of a Dask scheduler whose workers do the work, such as `tcp://host:8786`.
        resume: A folder in which the machines that are finished are kept: the same call continues an interrupted sweep
            from there and ends with the same numbers to the last bit, and `diffdrive replay` runs any machine of it.
        out: The same as `resume`, and the result is saved there, too (`sweep.json`). Give one of the two.
        progress: Called with (stage, done, of how many).
        started: Called with the plan and the notes, when all machines are found possible and before the first one runs.
        notify: Called with a sentence where something keeps workers from their work; by default it is logged.
        throw: Raise an error where a machine diverged.

    Raises:
        ResultError: A machine diverged, with `throw`.
        ParameterError: A sweep that cannot be; names what is wrong.
        MotionError: A motion leaves the axis's limits.

    Examples:
        >>> swept = sweep(axis, lap, vary={"load": "uniform:0..12 kN"}, samples=4096, tolerance=2e-6)
        >>> swept.exceedance(axis.name).interval

    """
    require_axis(axis)
    for name, other in (against or {}).items():
        require_axis(other, f"against {name}")
    if machine is not None:
        require_axis(machine, "machine")
    if resume is not None and out is not None:
        raise ParameterError("resume, out: give one: out keeps the finished machines as resume does, and the result")
    require_choice("by", "error", by, ERRORS)
    if tolerance is not None and not tolerance > 0.0:
        raise ParameterError(f"tolerance: must be above zero, in m, got {tolerance!r}")
    about = axis if machine is None else machine
    varied = all_that_varies(about.drive, vary or {}, spread, _left_open(identified, about))
    notes = () if identified is not None else uncertainty_notes(about, varied)
    spec = SweepSpec.of(
        axis, motions, varied.vary, int(samples), machine=machine, against=dict(against or {}), method=method,
        seed=int(seed), load=load if isinstance(load, str) else f"{float(load):.17g}", settle=float(settle),
        correlation=varied.correlation, precision=precision,
    )  # fmt: skip
    kept = resume if out is None else out
    folder = None if kept is None else Path(kept)
    with reporting(progress) as advance:
        result = run_sweep(
            spec, folder, _engine(spec, workers, cluster), tolerance=tolerance, by=by, started=started, notify=notify,
            notes=notes, done=lambda machines: advance("machines", machines, spec.samples),
        )  # fmt: skip
    if out is not None:
        result.save(out)
    return result.require_ok() if throw else result


def run_sweep(
    spec: SweepSpec, folder: Path | None, engine: Engine, *, tolerance: float | None, by: str, started: Started,
    notify: Notify, done: Callable[[int], None], notes: tuple[str, ...] = (),
) -> SweepResult:  # fmt: skip
    """Run the machines of a sweep that are not in the folder yet, and say what became of all.

    `notes` go before those of the plan. Raises `ParameterError` for a sweep that cannot be run, before anything is
    written.
    """
    plan = spec.plan()
    require_resources(plan, Path(tempfile.gettempdir()) if folder is None else folder)
    if folder is not None:
        missing_parts(plan, folder / PARTS)  # what is there may be of another sweep
    notes += convergence_notes(plan)

    def begin() -> None:
        started(plan, notes)
        if folder is not None:
            write_spec(spec, folder)

    with _parts_folder(folder) as parts:
        rows = run_parts(plan, parts, done, _preceded(engine, begin), notify)
        order = [("motion", "ascending"), ("controller", "ascending"), ("machine", "ascending")]
        frame = rows.to_table().sort_by(order)
    diverged = int(np.sum(frame["diverged"].to_numpy(zero_copy_only=False)))
    message = "ok" if not diverged else f"{diverged} of {len(frame)} runs diverged"
    status = Status(not diverged, message, code="diverged" if diverged else "ok")
    return SweepResult(frame, plan, spec.vary, tolerance, by, status, notes)


def _left_open(identified: IdentificationResult | str | Path | None, about: Axis) -> Distributions | None:
    """What an identification left open: the one that is given, else that of the axis that the machines vary about."""
    if isinstance(identified, IdentificationResult):
        return about_identified(identified.axis)
    if identified is not None:
        return read_uncertainty(Path(identified))
    return None if about.uncertainty is None else about_nominal(about.uncertainty)


def _engine(spec: SweepSpec, workers: int | None, cluster: str | None) -> Engine:
    """Who computes the parts; raises `ParameterError` for one that cannot."""
    if cluster is not None:
        from tuning.sweeps.cluster import on_cluster

        return on_cluster(spec, cluster)
    if workers is not None:
        from tuning.sweeps.workers import on_workers

        return on_workers(spec, workers)
    return in_process


def _preceded(engine: Engine, begin: Callable[[], None]) -> Engine:
    """An engine before which something is done, when every machine has been found possible and somebody is there."""

    def begun(plan: SweepPlan, wanted: list[int], notify: Notify) -> ComputedParts:
        parts = engine(plan, wanted, notify)  # which may find that nobody is there
        begin()
        yield from parts

    return begun


@contextlib.contextmanager
def _parts_folder(folder: Path | None) -> Iterator[Path]:
    """Where the parts go: into the folder, or nowhere for long."""
    if folder is not None:
        remove_temporary(folder / PARTS)
        yield folder / PARTS
        return
    with tempfile.TemporaryDirectory(prefix="sweep-") as room:
        yield Path(room)
