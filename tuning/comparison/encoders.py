"""What two encoders say of the screw between them, before and after: `diffdrive.compare_encoders` of each log.

The reversal error is backlash and wind-up of the screw under friction. Where friction has changed, so has the wind-up,
in proportion; what that does not explain of the reversal error's change is a change of the backlash. How much of
the reversal error was wind-up has an interval of its own, over all of which it must not be explained. The wind-up by
acceleration is not compared: it is in proportion to the table's share of the moving mass, which a payload changes.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from diffdrive.axis import Axis
from diffdrive.logs import Log
from diffdrive.logs.checks.encoders import compared
from diffdrive.logs.encoders.comparison import FEWEST_PASSES
from diffdrive.logs.encoders.regression import Estimate
from diffdrive.logs.encoders.result import EncoderComparison
from tuning.comparison.change import Change
from tuning.comparison.changes import CONFIDENCE, Difference, Estimates, Interval
from tuning.comparison.sides import Sides

QUANTITIES = (
    ("reversal_error", "the reversal error of motor against table", "m"),
    ("per_turn", "the error per turn of the screw", "m"),
    ("linear", "the linear error of motor against table", "m/m"),
)
BLIND = "one encoder, so the backlash cannot be seen: log motor and scale to have it compared, too"


class EncoderChanges(NamedTuple):
    """What the encoders show before and after, what of it has changed, and the change of the backlash (m) if known."""

    changes: tuple[Change, ...]
    backlash: Interval | None
    notes: tuple[str, ...]


def encoders_of(axis: Axis, before: Sequence[Log], after: Sequence[Log]) -> Sides[EncoderComparison]:
    """Motor against table of each log that has both."""
    notes: list[str] = []
    sides = []
    for logs, name in ((before, "before"), (after, "after")):
        found = []
        for log in logs:
            if log.motor_position is None:
                continue
            comparison = compared(log, axis)
            if comparison is None:
                why = "another unit or sign, or hardly any travel"
                notes.append(f"{name}, {log.name}: motor and table are not compared: {why}")
            else:
                found.append(comparison)
        if all(log.motor_position is None for log in logs):
            notes.append(f"{name}: {BLIND}")
        sides.append(tuple(found))
    return Sides(sides[0], sides[1], tuple(notes))


def encoder_changes(sides: Sides[EncoderComparison], friction: Interval | None, level: float) -> EncoderChanges:
    """What differs between the sides; `friction` is the relative change of the Coulomb friction, None if unknown."""
    if not sides.are_comparable:
        return EncoderChanges((), None, sides.notes)
    pairs = [
        (name, label, unit, _pooled(sides.before, name), _pooled(sides.after, name)) for name, label, unit in QUANTITIES
    ]
    known = [(name, label, unit, one, other) for name, label, unit, one, other in pairs if one and other]
    if not known:
        return EncoderChanges((), None, sides.notes)
    difference = Difference(
        tuple(name for name, *_ in known), _side([one for *_, one, _ in known]), _side([other for *_, other in known])
    )
    changed = difference.explanations(level)[0]
    rows = []
    for name, label, unit, one, other in known:
        freed = tuple(dict.fromkeys((*changed, name)))
        interval = difference.intervals(freed)[difference.rows(freed).index(difference.rows([name])[0])]
        least = difference.smallest(name, changed, level)
        rows.append(
            Change(f"encoders.{name}", label, unit, one.value, other.value, interval, False, name in changed, least)
        )
    backlash = None
    if "reversal_error" in changed and friction is not None:
        reversal = next(row.change for row in rows if row.path == "encoders.reversal_error")
        backlash = _backlash(reversal, sides.before, friction)
    return EncoderChanges(tuple(rows), backlash, sides.notes)


class _Pooled(NamedTuple):
    value: float
    variance: float
    freedom: float


def _pooled(side: Sequence[EncoderComparison], name: str) -> _Pooled | None:
    """One estimate of several logs, each by the inverse of its variance, wider where they scatter more (Birge).

    None where no log has one, or only such without any scatter: the motor's position is a copy of the table's then.
    """
    found = [(getattr(one, name), _freedom(one)) for one in side]
    known = [(estimate, freedom) for estimate, freedom in found if estimate and 0.0 < estimate.half_width < np.inf]
    if not known:
        return None
    values = np.array([estimate.value for estimate, _ in known])
    deviations = np.array([_deviation(estimate, freedom) for estimate, freedom in known])
    weights = deviations**-2.0 / np.sum(deviations**-2.0)
    mean = float(weights @ values)
    scatter = float(np.sum(((values - mean) / deviations) ** 2)) / max(1, len(values) - 1)
    variance = max(1.0, scatter) / float(np.sum(deviations**-2.0))
    return _Pooled(mean, variance, float(sum(freedom for _, freedom in known)))


def _freedom(one: EncoderComparison) -> float:
    """Of an interval: the passes beyond the columns that only their differences show."""
    return max(2.0, len(one.reversals) + 1.0 - (FEWEST_PASSES - 2.0))


def _deviation(estimate: Estimate, freedom: float) -> float:
    return estimate.half_width / float(student.ppf(0.5 + 0.5 * CONFIDENCE, freedom))


def _side(several: Sequence[_Pooled]) -> Estimates:
    values, variances = np.array([one.value for one in several]), np.array([one.variance for one in several])
    return Estimates(values, np.diag(variances), min(one.freedom for one in several))


def _backlash(reversal: Interval, before: Sequence[EncoderComparison], friction: Interval) -> Interval:
    """What the wind-up under a changed friction does not explain of the reversal error's change (m)."""
    known = [one.wind_up for one in before if one.wind_up is not None]
    most = max((abs(one.reversal_error.value) for one in before if one.reversal_error is not None), default=0.0)
    low = min((one.low for one in known), default=0.0)
    high = max((one.high for one in known), default=most)
    explained = [wound * share for wound in (low, high) for share in (friction.low, friction.high)]
    middle = 0.5 * (low + high) * friction.value
    return Interval(reversal.value - middle, reversal.low - max(explained), reversal.high - min(explained))
