"""One number that is compared, and what is said of it."""

from typing import NamedTuple

import numpy as np

from diffdrive.support.spans import format_span
from tuning.comparison.changes import Interval

PER_CENT = 100.0


class Change(NamedTuple):
    """One number of the axis before and after, in its unit, and its change between the ends of its 95 % interval.

    A relative change is a share of the value before. `smallest` is the least change, of the same kind, that would have
    been found nine times in ten; None where none is stated.
    """

    path: str  # in an axis, or `encoders.` and what they show
    label: str  # in words
    unit: str
    before: float
    after: float
    change: Interval
    is_relative: bool
    has_changed: bool
    smallest: float | None = None

    @property
    def direction(self) -> str:
        """Forwards or backwards; empty for what is of both."""
        return {"positive": "forwards", "negative": "backwards"}.get(self.path.rpartition(".")[2], "")

    @property
    def verb(self) -> str:
        """Whether it rose or fell."""
        return "rose" if self.change.value > 0 else "fell"

    @property
    def by(self) -> str:
        """By how much, with the interval: `10.1 % (9.8 to 10.4)`."""
        return sized(self.change, self.factor, self.shown_unit)

    @property
    def changed_to(self) -> float:
        """The value before, changed by as much. `after` is by itself: with the others unchanged the change is another,
        and known better, so it may even go the other way than from `before` to `after`.
        """
        return self.before * (1.0 + self.change.value) if self.is_relative else self.before + self.change.value

    @property
    def least(self) -> str:
        """The smallest change that would have been found, with its unit."""
        return "" if self.smallest is None else f"{self.factor * self.smallest:.2g} {self.shown_unit}"

    @property
    def shown_unit(self) -> str:
        """That of the change."""
        return "%" if self.is_relative else {"m": "um", "m/N": "nm/N", "m/m": "um/m"}.get(self.unit, self.unit)

    @property
    def factor(self) -> float:
        """From SI to it."""
        return PER_CENT if self.is_relative else {"m": 1e6, "m/N": 1e9, "m/m": 1e6}.get(self.unit, 1.0)


def sized(change: Interval, factor: float, unit: str) -> str:
    """The size of a change, with its interval, in another unit; below zero is then the other way."""
    sign = factor if change.value >= 0.0 else -factor
    low, high = sorted((sign * change.low, sign * change.high))
    size, least, most = format_span((sign * change.value, low, high))
    return f"{size} {unit} ({least} to {most})"


def relative(logarithm: Interval) -> Interval:
    """The change of a number as a share of it, from that of its logarithm."""
    with np.errstate(over="ignore"):  # an interval without end
        return Interval(*(float(np.expm1(one)) for one in logarithm))


def sentence(changes: list[Change], more: str = "") -> str:
    """What has changed, in words: both directions of a parameter together."""
    first = changes[0]
    verbs = {one.verb for one in changes}
    parts = [
        f"{one.verb if len(verbs) > 1 or one is first else ''} by {one.by} {one.direction}".strip() for one in changes
    ]
    unit = "" if first.unit == "1" else f" {first.unit.replace('*', ' ')}"
    factor = 1.0
    if first.unit in ("m", "m/N", "m/m"):
        unit, factor = f" {first.shown_unit}", first.factor
    was, now = (
        " and ".join(f"{factor * value:.4g}" for value in values)
        for values in zip(*((one.before, one.changed_to) for one in changes), strict=True)
    )
    return f"{first.label} {' and '.join(parts)}, from {was} to {now}{unit}{more}"
