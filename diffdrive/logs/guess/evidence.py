"""What the numbers of two columns say of each other: one motion, a velocity of it, a force behind it, feedback."""

from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from diffdrive.logs.checks.balance import EXPLAINS
from diffdrive.logs.checks.dynamics import DynamicsFit, inverse_dynamics
from diffdrive.logs.checks.ratios import SAME_MOTION
from diffdrive.logs.checks.statistics import derivative
from diffdrive.logs.log import Signal

FINE = 1e3  # Hz: motion and friction show at this rate, and long logs of faster loops cost less
# A loop feeds the noise of its encoder back: third differences of command and position, which no motion survives, then
# have a correlation of -0.5 to -0.94 (15 machines of four kinds, every sample or snapshots), and those of command and
# reference one within 0.13, also where the reference is rounded.
FEEDBACK, NO_FEEDBACK = 0.3, 0.15
SIGNIFICANT = 3.0  # standard deviations
LONGEST_STEP = 2.5  # periods without a sample are a gap, as for the reader


class Balance(NamedTuple):
    """A force against the motion: what inverse dynamics makes of it, per unit of either column, and the sign."""

    fit: DynamicsFit
    sign: float


@dataclass(frozen=True)
class Recording:
    """Columns [n] of a trace, `period` (s) apart, over its longest stretch without a gap or a missing value."""

    period: float
    columns: dict[str, Signal]

    @property
    def rate(self) -> float:
        """Rows per second."""
        return 1.0 / self.period

    def __post_init__(self) -> None:
        block = max(1, round(1.0 / (self.period * FINE)))
        object.__setattr__(self, "_block", block)
        object.__setattr__(self, "_means", {name: _means(values, block) for name, values in self.columns.items()})

    def mean(self, name: str) -> Signal:
        """A column's means over stretches of at most a millisecond."""
        means: dict[str, Signal] = self._means  # type: ignore[attr-defined]
        return means[name]

    @property
    def mean_period(self) -> float:
        """Seconds from one mean to the next."""
        return self.period * float(self._block)  # type: ignore[attr-defined]

    def slope(self, name: str, other: str) -> float | None:
        """Units of `name` that go along with one of `other`, either sign; None where they are not one motion."""
        return _slope(self.mean(name), self.mean(other))

    def slope_of_velocity(self, name: str, position: str) -> float | None:
        """Units of `name` that go along with one of `position` a second; None where it is no such velocity."""
        if len(self.mean(name)) < 10:
            return None
        speed = derivative(self.mean(position), self.mean_period, 1)
        return _slope(derivative(self.mean(name), self.mean_period, 0), speed)

    def balance(self, position: str, force: str) -> Balance | None:
        """Mass and friction behind a motion; None where this force does not explain it, or not with one sign."""
        if len(self.mean(force)) < 100:
            return None
        fit = inverse_dynamics(self.mean(position), self.mean(force), self.mean_period)
        if fit is None or not fit.misfit < EXPLAINS:
            return None
        signs = {
            float(np.sign(one.value)) for one in (fit.mass, fit.friction) if abs(one.value) > SIGNIFICANT * one.std
        }
        return Balance(fit, signs.pop()) if len(signs) == 1 else None

    def feedback(self, command: str, position: str) -> float:
        """Correlation of the noise of a command with that of a position; near zero where it is not fed back."""
        pair = [np.diff(self.columns[name], 3) for name in (command, position)]
        if min(len(pair[0]), *(float(np.std(one)) for one in pair)) == 0.0:
            return 0.0
        first, second = (one - np.mean(one) for one in pair)
        return float(np.mean(first * second) / np.sqrt(np.mean(first * first) * np.mean(second * second)))


def recording_of(columns: dict[str, Signal], times: Signal, period: float) -> Recording:
    """Columns [n] at `times` (s), over their longest stretch without a gap or a missing value."""
    usable = {name: values for name, values in columns.items() if np.mean(np.isfinite(values)) > 0.9}
    broken = np.zeros(len(times), bool)
    broken[1:] = np.diff(times) > LONGEST_STEP * period
    missing = np.zeros(len(times), bool)
    for values in usable.values():
        missing |= ~np.isfinite(values)
    edges = np.flatnonzero(np.concatenate([[True], broken[1:] | missing[1:] | missing[:-1], [True]]))
    start, stop = max(pairwise(edges), key=lambda ends: ends[1] - ends[0])
    pieces = {name: values[start:stop] for name, values in usable.items()}
    return Recording(period, {name: values for name, values in pieces.items() if np.ptp(values) > 0})


def _means(values: Signal, block: int) -> Signal:
    count = len(values) // block
    return values if block == 1 else values[: count * block].reshape(count, block).mean(axis=1)


def _slope(values: Signal, other: Signal) -> float | None:
    """The slope of the line through the origin of both deviations, its sign included."""
    # not by BLAS: its threads cost more than so short a sum on a machine that is busy
    values, other = values - np.mean(values), other - np.mean(other)
    size, other_size = (float(np.sqrt(np.mean(one * one))) for one in (values, other))
    if size == 0.0 or other_size == 0.0:
        return None
    correlation = float(np.mean(values * other)) / (size * other_size)
    return float(np.sign(correlation)) * size / other_size if abs(correlation) > SAME_MOTION else None
