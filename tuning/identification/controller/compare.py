"""Whether two controllers are one: a sentence for each gain that differs."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from tuning.identification.controller.gains import PARTS, Parts

FALSE_ALARM = 0.01  # of all gains together, each tested at a sixth of it (Bonferroni)
SMALLEST = 0.02  # relative change that is worth a sentence: what fits of snapshots are accurate to


class Difference(NamedTuple):
    """A gain that differs between two controllers, named `first` and `second`."""

    name: str
    unit: str
    values: tuple[float, float]
    sources: tuple[str, str]

    @property
    def sentence(self) -> str:
        """In words, such as: K_v is 15 1/s in today, 90 1/s in before."""
        (one, other), (here, there) = self.values, self.sources
        return f"{self.name} is {_number(one)}{self.unit} in {here}, {_number(other)}{self.unit} in {there}"


class _Shown(NamedTuple):
    name: str
    unit: str
    value: Callable[[float], float]


_SHOWN = (
    _Shown("K_v", " 1/s", np.exp),
    _Shown("the velocity gain", " N s/m", np.exp),
    _Shown("the reset time", " ms", lambda rate: 1e3 / rate if rate > 0 else np.inf),
    _Shown("the velocity feed-forward", "", lambda share: share),
    _Shown("the acceleration feed-forward", " kg", lambda mass: mass),
    _Shown("the following error per speed", " ms", lambda time: 1e3 * time),
)


class Named(NamedTuple):
    """The controller of a log, or of a drive file, by its name."""

    name: str
    parts: Parts


def differences_of(pairs: Sequence[tuple[Named, Named]]) -> tuple[Difference, ...]:
    """The gains in which the controllers of each pair differ.

    All pairs together show one by chance in a share `FALSE_ALARM`, or fewer (Bonferroni).
    """
    return tuple(
        difference
        for one, other in pairs
        for difference in differences(one.parts, other.parts, (one.name, other.name), FALSE_ALARM / len(pairs))
    )


def differences(
    one: Parts, other: Parts, sources: tuple[str, str], false_alarm: float = FALSE_ALARM
) -> tuple[Difference, ...]:
    """The gains that differ by more than `SMALLEST` beyond what chance explains (Wald's test of each).

    What is the same but for `SMALLEST` shows a difference in a share `false_alarm` of the comparisons, or fewer.
    """
    distance, least = np.abs(one.values - other.values), needed(one, other, false_alarm)
    found = [
        Difference(shown.name, shown.unit, (shown.value(one.values[k]), shown.value(other.values[k])), sources)
        for k, shown in enumerate(_SHOWN)
        if distance[k] > least[k]
    ]
    # the following error per speed is K_v and the feed-forward once more
    named = {difference.name for difference in found}
    if named & {"K_v", "the velocity feed-forward"}:
        found = [difference for difference in found if difference.name != "the following error per speed"]
    return tuple(found)


def needed(one: Parts, other: Parts, false_alarm: float = FALSE_ALARM, missed: float = 0.5) -> np.ndarray:
    """How far each of `PARTS` must change to be said to differ, but for a share `missed` of the changes."""
    deviation = np.sqrt(np.diag(one.covariance + other.covariance))
    freedom = min(one.freedom, other.freedom)
    quantiles = student.isf(0.5 * false_alarm / len(PARTS), freedom) + student.isf(missed, freedom)
    return smallest_change(one, other) + float(quantiles) * deviation


def smallest_change(one: Parts, other: Parts) -> np.ndarray:
    """`SMALLEST` of each of `PARTS`; of a mass and a time, which may be zero, of what the gains would make of it."""
    kp, kv = np.exp(min(one.values[0], other.values[0])), np.exp(max(one.values[1], other.values[1]))
    rate = max(abs(one.values[2]), abs(other.values[2]))
    return SMALLEST * np.array([1.0, 1.0, rate, 1.0, kv / kp, 1.0 / kp])


def _number(value: float) -> str:
    return "none" if not np.isfinite(value) else f"{value:.3g}"
