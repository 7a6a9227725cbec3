"""What became of the machines of a sweep: how often each controller misses, and what drives the spread."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds

from diffdrive.errors import ParameterError
from diffdrive.results import Result, Status
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.sensitivity import Influence, influences
from tuning.sweeps.summary import ERRORS, Group, exceedance, groups, quantile

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
    by: str  # the error that counts, `peak` or `rms`
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
        return "\n".join([*rows, *(f"- {note}" for note in self.notes)])

    def as_dict(self) -> dict[str, object]:
        found = []
        for motion in self.plan.motions:
            for controller in self.controllers:
                row: dict[str, object] = {"controller": controller, "motion": motion}
                row |= {
                    f"{self.by}_m_{share:g}": self.quantile(controller, share, motion) for share in (0.5, 0.95, 0.99)
                }
                if self.tolerance is not None:
                    row["exceedance"] = self.exceedance(controller, motion)._asdict()
                found.append(row)
        return {
            "machines": self.plan.samples, "vary": dict(self.vary), "tolerance_m": self.tolerance, "results": found,
            "notes": list(self.notes),
        }  # fmt: skip


def group_influences(plan: SweepPlan, group: Group, by: str) -> list[Influence]:
    """What drives the spread of a controller on a motion."""
    return influences(list(plan.units), varied_values(plan, group), group.error(by), plan.seed)


def varied_values(plan: SweepPlan, group: Group) -> np.ndarray:
    """The values of what varied, [machines, quantities]."""
    return np.stack([group.column(name) for name in plan.units], axis=1)
