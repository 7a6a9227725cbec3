"""`tuning.sweep`: how often an axis misses its tolerance over the machines, loads and noise that it may meet."""

import contextlib
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.motion.motion import Motion
from diffdrive.results import Result, Status
from diffdrive.support.atomic_write import remove_temporary
from tuning.progress import Progress, reporting
from tuning.sweeps.engine import Precision, most_in_a_part
from tuning.sweeps.parts import Engine, MachinesDone, Notify, in_process, missing_parts, run_parts
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.room import require_resources
from tuning.sweeps.samples import Method
from tuning.sweeps.sensitivity import Influence, influences
from tuning.sweeps.summary import ERRORS, Group, exceedance, groups, quantile

PARTS = "parts"  # of a sweep's folder: the machines that were run
INFLUENCES_SHOWN = 3  # quantities that drive the spread, in a summary


class Exceedance(NamedTuple):
    """How often a controller misses the tolerance, with Wilson's 95 % interval."""

    share: float
    interval: tuple[float, float]


@dataclass(frozen=True, repr=False, eq=False)
class SweepResult(Result):
    """What became of every machine of a sweep under every controller, on every motion.

    `frame` is an Arrow table, a row a run (`frame.to_pandas()`, `polars.from_arrow(frame)`): the machine's number,
    controller, motion, the values of what varied, errors (m), command noise (N), and whether it diverged. A machine
    that diverged misses every tolerance. Not ok: a machine diverged.
    """

    frame: pa.Table
    plan: SweepPlan
    vary: Mapping[str, str]
    tolerance: float | None  # m
    by: str
    status: Status
    notes: tuple[str, ...] = ()

    schema: ClassVar[str] = "sweep/1"

    @property
    def controllers(self) -> tuple[str, ...]:
        """Their names."""
        return tuple(self.plan.controllers)

    def groups(self) -> list[Group]:
        """The runs of every controller on every motion."""
        return groups(ds.dataset(self.frame), list(self.plan.controllers), list(self.plan.motions))

    def group(self, controller: str, motion: str | None = None) -> Group:
        """The runs of one controller, on one motion where there are several; raises `ParameterError`."""
        motion = next(iter(self.plan.motions)) if motion is None else motion
        if controller not in self.plan.controllers or motion not in self.plan.motions:
            raise ParameterError(
                f"no controller {controller!r} on a motion {motion!r}; there are {', '.join(self.controllers)} on "
                f"{', '.join(self.plan.motions)}"
            )
        (found,) = groups(ds.dataset(self.frame), [controller], [motion])
        return found

    def exceedance(self, controller: str, motion: str | None = None, *, tolerance: float | None = None) -> Exceedance:
        """How often a controller's error (`by`) is above the tolerance (m; by default the sweep's)."""
        tolerance = self.tolerance if tolerance is None else tolerance
        if tolerance is None:
            raise ParameterError("tolerance: the sweep had none; give one in m, such as 2e-6")
        found = exceedance(self.group(controller, motion).error(self.by), tolerance)
        return Exceedance(found.value, (found.low or 0.0, 1.0 if found.high is None else found.high))

    def quantile(self, controller: str, share: float, motion: str | None = None) -> float:
        """The error (m) that such a share of the machines stays below; infinite where too many diverged."""
        return quantile(self.group(controller, motion).error(self.by), share).value

    def influences(self, controller: str, motion: str | None = None) -> list[Influence]:
        """Which of what varied drives the spread of a controller's error, the strongest first."""
        return group_influences(self.plan, self.group(controller, motion), self.by)

    def headline(self) -> str:
        machines, first = self.plan.samples, self.controllers[0]
        machines_run = f"{machines} machines under {', '.join(self.controllers)}"
        if self.tolerance is None:
            return f"{machines_run}; {ERRORS[self.by]} of {first}: {1e6 * self.quantile(first, 0.95):.3g} µm at 95 %"
        missed = self.exceedance(first)
        low, high = missed.interval
        return (
            f"{machines_run}; {first} misses {1e6 * self.tolerance:.3g} µm in {100 * missed.share:.3g} % "
            f"({100 * low:.3g} to {100 * high:.3g})"
        )

    def summary(self) -> str:
        rows = [
            self.headline(),
            f"{'controller':<16}{'motion':<16}{'median µm':>11}{'95 % µm':>11}{'diverged':>10}  misses",
        ]
        for motion in self.plan.motions:
            for controller in self.controllers:
                half, most = (1e6 * self.quantile(controller, share, motion) for share in (0.5, 0.95))
                diverged = int(np.sum(self.group(controller, motion).diverged))
                row = f"{controller:<16}{motion:<16}{half:>11.3g}{most:>11.3g}{diverged:>10}"
                if self.tolerance is not None:
                    share, (low, high) = self.exceedance(controller, motion)
                    row += f"  {100 * share:.3g} % ({100 * low:.3g} to {100 * high:.3g})"
                rows.append(row)
                drive = [
                    f"{influence.name} {100 * influence.share:.0f} %"
                    for influence in self.influences(controller, motion)[:INFLUENCES_SHOWN]
                ]
                rows += [f"  spread of {controller}: {', '.join(drive)}"] if drive else []
        return "\n".join(rows)

    def as_dict(self) -> dict[str, object]:
        found = []
        for motion in self.plan.motions:
            for controller in self.controllers:
                row: dict[str, object] = {"controller": controller, "motion": motion}
                row |= {f"{self.by}_{share:g}": self.quantile(controller, share, motion) for share in (0.5, 0.95, 0.99)}
                if self.tolerance is not None:
                    row["exceedance"] = self.exceedance(controller, motion)._asdict()
                found.append(row)
        return {
            "machines": self.plan.samples, "vary": dict(self.vary), "tolerance_m": self.tolerance, "results": found,
        }  # fmt: skip


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


def group_influences(plan: SweepPlan, group: Group, by: str) -> list[Influence]:
    """What drives the spread of a controller on a motion."""
    return influences(list(plan.units), varied_values(plan, group), group.error(by), plan.seed)


def varied_values(plan: SweepPlan, group: Group) -> np.ndarray:
    """The values of what varied, [machines, quantities]."""
    return np.stack([group.column(name) for name in plan.units], axis=1)
