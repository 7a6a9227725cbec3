"""Whether the cascade that made the commands is another after than before: `tuning.identification.controller`."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from diffdrive.errors import LogError
from diffdrive.logs import Log
from tuning.comparison.change import Change, relative
from tuning.comparison.changes import CONFIDENCE, POWER, Estimates, Interval
from tuning.comparison.changes import Difference as Changes
from tuning.comparison.sides import Sides
from tuning.identification.controller.compare import (
    Difference,
    Named,
    differences,
    differences_of,
    needed,
    smallest_change,
)
from tuning.identification.controller.gains import Parts, pooled
from tuning.identification.controller.workflow import LogController, of_log


class _Part(NamedTuple):
    """One of `PARTS` of a controller."""

    path: str
    name: str  # of its `Difference`
    label: str
    unit: str
    is_logarithm: bool


_PARTS = (
    _Part("controller.kp", "K_v", "K_v", "1/s", True),
    _Part("controller.kv", "the velocity gain", "the velocity gain", "N*s/m", True),
    _Part("controller.reset_rate", "the reset time", "the inverse reset time", "1/s", False),
    _Part("controller.velocity_feedforward", "the velocity feed-forward", "the velocity feed-forward", "1", False),
    _Part(
        "controller.acceleration_feedforward", "the acceleration feed-forward", "the acceleration feed-forward", "kg",
        False,
    ),
    _Part("controller.following_time", "the following error per speed", "the following error per speed", "s", False),
)  # fmt: skip


class ControllerChanges(NamedTuple):
    """The gains before and after, and a path and a sentence for each that differs.

    None, and the reason among the notes, where they are not compared.
    """

    changes: tuple[Change, ...]
    sentences: tuple[tuple[str, str], ...]
    notes: tuple[str, ...]


def controllers_of(before: Sequence[Log], after: Sequence[Log], control_rate: float | None) -> Sides[LogController]:
    """The cascade of each log that has a reference and shows one; `control_rate` (Hz) where it is known."""
    notes: list[str] = []
    first = _of_side(before, "before", control_rate, notes)
    second = _of_side(after, "after", control_rate, notes)
    return Sides(first, second, tuple(notes))


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
    elif reasons:
        notes.append(f"the controllers {name} are those of {len(found)} logs of {len(logs)}: {'; '.join(reasons)}")
    several = [Named(one.log, one.parts) for one in found]
    pairs = [(one, other) for k, one in enumerate(several) for other in several[:k]]
    notes += [
        f"{name}, the controllers of the logs differ: {one.sentence}"
        for one in (differences_of(pairs) if pairs else ())
    ]
    return tuple(found)


def controller_changes(sides: Sides[LogController], level: float) -> ControllerChanges:
    """The gains before and after, and a sentence for each that differs; a false one in a share `level`, or fewer.

    Half of the level is that of the gains one by one; the other is that of all together, by which two that the logs do
    not tell apart are seen to differ.
    """
    if not sides.are_comparable:
        return ControllerChanges((), (), sides.notes)
    one, other = (pooled([log.parts for log in side]) for side in (sides.before, sides.after))
    found = {difference.name: difference for difference in differences(one, other, ("before", "after"), 0.5 * level)}
    smallest = needed(one, other, 0.5 * level, 1.0 - POWER)
    changes = tuple(_change(k, one, other, _PARTS[k].name in found, float(smallest[k])) for k in range(len(_PARTS)))
    sentences = tuple(
        (part.path, _sentence(found[part.name], change))
        for part, change in zip(_PARTS, changes, strict=True)
        if change.has_changed
    )
    if not sentences and (rivals := _jointly(one, other, 0.5 * level)):
        sentences = (("controller", f"the controller has changed, in {rivals}: these logs do not decide which"),)
    return ControllerChanges(changes, sentences, sides.notes)


def _jointly(one: Parts, other: Parts, level: float) -> str:
    """The gains by any of which all of the difference is explained; empty where there is none.

    What fits are accurate to is anything up to `SMALLEST` either way: a third of its square in variance.
    """
    count = len(_PARTS) - 1  # the following error per speed is K_v and the feed-forward once more
    accuracy = np.diag(smallest_change(one, other)[:count] ** 2 / 3.0)
    sides = [
        Estimates(side.values[:count], side.covariance[:count, :count] + 0.5 * accuracy, side.freedom)
        for side in (one, other)
    ]
    explanations = Changes(tuple(part.label for part in _PARTS[:count]), *sides).explanations(level)
    return " or ".join(" and ".join(labels) for labels in explanations if labels)


def _change(k: int, one: Parts, other: Parts, has_changed: bool, smallest: float) -> Change:
    path, _, label, unit, is_logarithm = _PARTS[k]
    value = float(other.values[k] - one.values[k])
    deviation = float(np.sqrt(one.covariance[k, k] + other.covariance[k, k]))
    half = float(student.ppf(0.5 + 0.5 * CONFIDENCE, min(one.freedom, other.freedom))) * deviation
    interval, ends = Interval(value, value - half, value + half), (float(one.values[k]), float(other.values[k]))
    if is_logarithm:
        interval, ends = relative(interval), (float(np.exp(ends[0])), float(np.exp(ends[1])))
    return Change(path, label, unit, *ends, interval, is_logarithm, has_changed, smallest)


def _sentence(found: Difference, change: Change) -> str:
    was, now = (f"{value:.3g}" if np.isfinite(value) else "none" for value in found.values)
    by = f" by {change.by}" if change.is_relative else ""
    verb = "rose" if found.values[1] > found.values[0] else "fell"
    return f"{found.name} {verb}{by}, from {was} to {now}{found.unit}"
