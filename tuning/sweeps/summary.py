"""What a sweep says: quantiles, how often a tolerance is missed, which controller is better, which machines are worst.

A machine that diverged has no error to speak of: it counts as one of infinite error, so that it moves every quantile
and every count, and is never dropped.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds
from jaxtyping import Float
from scipy import stats

SHARES = (0.5, 0.9, 0.95, 0.99)
LEVEL = 0.95
ERRORS = {"rms": "RMS error", "peak": "peak error"}  # of a column `rms_m`, ...

Values = Float[np.ndarray, " n"]


class Interval(NamedTuple):
    """A value and its 95 % interval; an end is None where there are too few machines for one."""

    value: float
    low: float | None
    high: float | None


class Group(NamedTuple):
    """One controller on one motion, its machines in their order."""

    controller: str
    motion: str
    table: pa.Table

    def column(self, name: str) -> Values:
        """The numbers of a column; NaN where there are none."""
        return np.asarray(self.table[name].to_numpy(zero_copy_only=False), float)

    @property
    def diverged(self) -> np.ndarray:
        """Which machines diverged."""
        return np.asarray(self.table["diverged"].to_numpy(zero_copy_only=False), bool)

    def error(self, by: str = "peak") -> Values:
        """An error (`peak` or `rms`) in m of every machine, infinite where it diverged."""
        return np.where(self.diverged, np.inf, self.column(f"{by}_m"))


def groups(rows: ds.Dataset, controllers: Sequence[str], motions: Sequence[str]) -> list[Group]:
    """Every controller on every motion."""
    found = []
    for motion in motions:
        for controller in controllers:
            wanted = (pc.field("motion") == motion) & (pc.field("controller") == controller)
            found.append(Group(controller, motion, rows.to_table(filter=wanted).sort_by("machine")))
    return found


def _end(value: float) -> float | None:
    return None if np.isnan(value) else float(value)


def quantile(values: Values, share: float) -> Interval:
    """A quantile and the order statistics that enclose it as for independent machines."""
    ends = stats.quantile_test(values, p=share).confidence_interval(LEVEL)
    return Interval(
        float(np.quantile(values, share, method="inverted_cdf")), _end(float(ends.low)), _end(float(ends.high))
    )


def exceedance(values: Values, tolerance: float) -> Interval:
    """The probability that a machine misses the tolerance, with Wilson's interval."""
    return proportion(values > tolerance)


def proportion(which: np.ndarray) -> Interval:
    """How often it is so, with Wilson's interval."""
    count, total = int(np.sum(which)), len(which)
    ends = stats.binomtest(count, total).proportion_ci(LEVEL, method="wilson")
    return Interval(count / total, float(ends.low), float(ends.high))


def worst(group: Group, count: int, by: str = "peak") -> list[int]:
    """Numbers of the machines with the largest errors, the worst first, of those that did not diverge."""
    return _machine_numbers(group, -group.column(f"{by}_m"), ~group.diverged, count)


def first_to_diverge(group: Group, count: int) -> list[int]:
    """Numbers of the machines that diverged, those first that did so earliest."""
    return _machine_numbers(group, group.column("diverged_at_s"), group.diverged, count)


def _machine_numbers(group: Group, key: Values, among: np.ndarray, count: int) -> list[int]:
    numbers = group.table["machine"].to_numpy(zero_copy_only=False)
    order = np.argsort(key, kind="stable")
    return [int(numbers[k]) for k in order[among[order]][:count]]


class Comparison(NamedTuple):
    """Two controllers on the same machines under the same loads and noise."""

    one: str
    other: str
    better: Interval  # share of the machines on which `one` has the smaller error
    ratio: float  # of the errors, one over other: the median over the machines


def compare(first: Group, second: Group, by: str = "peak") -> Comparison:
    """Machine by machine. Where both diverged neither is better."""
    mine, theirs = first.error(by), second.error(by)
    both = np.isfinite(mine) & np.isfinite(theirs)
    ratio = float(np.median(mine[both] / theirs[both])) if both.any() else np.nan
    return Comparison(first.controller, second.controller, proportion(mine < theirs), ratio)
