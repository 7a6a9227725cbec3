"""Whether the cascade that made the commands is another after than before: `tuning.identification.controller`."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from diffdrive.errors import LogError
from diffdrive.logs import Log
from tuning.comparison.change import Change, relative
from tuning.comparison.changes import CONFIDENCE, POWER, Interval
from tuning.identification.controller.compare import Named, differences, differences_of, needed
from tuning.identification.controller.gains import Parts, pooled
from tuning.identification.controller.workflow import LogController, of_log

# as `PARTS` of the controller: path, label as in `Difference`, unit, whether the part is a logarithm
GAINS = (
    ("controller.kp", "K_v", "1/s", True),
    ("controller.kv", "the velocity gain", "N*s/m", True),
    ("controller.reset_rate", "the reset time", "1/s", False),
    ("controller.velocity_feedforward", "the velocity feed-forward", "1", False),
    ("controller.acceleration_feedforward", "the acceleration feed-forward", "kg", False),
    ("controller.following_time", "the following error per speed", "s", False),
)


class ControllerChanges(NamedTuple):
    """The gains before and after; none, and the reason among the notes, where they are not compared."""

    changes: tuple[Change, ...]
    sentences: tuple[str, ...]
    notes: tuple[str, ...]


class ControllerSides(NamedTuple):
    """The controllers of each side's logs that show a cascade, and why others do not."""

    before: tuple[LogController, ...]
    after: tuple[LogController, ...]
    notes: tuple[str, ...]

    @property
    def are_comparable(self) -> bool:
        """Whether both sides show one."""
        return bool(self.before and self.after)


def controllers_of(before: Sequence[Log], after: Sequence[Log], control_rate: float | None) -> ControllerSides:
    """The cascade of each log that has a reference; `control_rate` (Hz) where it is known."""
    notes: list[str] = []
    sides = tuple(_of_side(logs, name, control_rate, notes) for logs, name in ((before, "before"), (after, "after")))
    return ControllerSides(*sides, tuple(notes))


def _of_side(logs: Sequence[Log], name: str, control_rate: float | None, notes: list[str]) -> tuple[LogController, ...]:
    found, reasons = [], []
    for log in logs:
        if log.reference is None:
            reasons.append(f"{log.name} has no reference")
            continue
        try:
            one = of_log(log, control_rate)
        except LogError as problem:
            reasons.append(str(problem))
            continue
        if one.is_explained:
            found.append(one)
        else:
            reasons.append(f"a position and speed cascade does not explain the command of {log.name}")
    if reasons and not found:
        notes.append(f"the controller is not compared: {name}, {reasons[0]}")
    several = [Named(one.log, one.parts) for one in found]
    pairs = [(one, other) for k, one in enumerate(several) for other in several[:k]]
    notes += [
        f"{name}, the controllers of the logs differ: {one.sentence}"
        for one in (differences_of(pairs) if pairs else ())
    ]
    return tuple(found)


def controller_changes(sides: ControllerSides, level: float) -> ControllerChanges:
    """The gains before and after, and a sentence for each that differs; a false one in a share `level`, or fewer."""
    if not sides.are_comparable:
        return ControllerChanges((), (), sides.notes)
    one, other = (pooled([log.parts for log in side]) for side in (sides.before, sides.after))
    found = {difference.name: difference for difference in differences(one, other, ("before", "after"), level)}
    smallest = needed(one, other, level, 1.0 - POWER)
    changes = tuple(_change(k, one, other, GAINS[k][1] in found, float(smallest[k])) for k in range(len(GAINS)))
    sentences = tuple(
        _sentence(found[change.label].values, found[change.label].unit, change)
        for change in changes
        if change.has_changed
    )
    return ControllerChanges(changes, sentences, sides.notes)


def _change(k: int, one: Parts, other: Parts, has_changed: bool, smallest: float) -> Change:
    path, label, unit, is_logarithm = GAINS[k]
    value = float(other.values[k] - one.values[k])
    deviation = float(np.sqrt(one.covariance[k, k] + other.covariance[k, k]))
    half = float(student.ppf(0.5 + 0.5 * CONFIDENCE, min(one.freedom, other.freedom))) * deviation
    interval, ends = Interval(value, value - half, value + half), (float(one.values[k]), float(other.values[k]))
    if is_logarithm:
        interval, ends = relative(interval), (float(np.exp(ends[0])), float(np.exp(ends[1])))
    return Change(path, label, unit, *ends, interval, is_logarithm, has_changed, smallest)


def _sentence(values: tuple[float, float], unit: str, change: Change) -> str:
    was, now = (f"{value:.3g}" if np.isfinite(value) else "none" for value in values)
    by = f" by {change.by}" if change.is_relative else ""
    verb = "rose" if values[1] > values[0] else "fell"
    return f"{change.label} {verb}{by}, from {was} to {now}{unit}"
