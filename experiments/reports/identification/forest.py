"""Parameters and their intervals relative to what the drive file says: a forest plot."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from experiments.reports.readable import interval, shown
from experiments.reports.report import new_figure, plain_logarithmic
from tuning.identification.estimates import EstimateStatus, ParameterEstimate

WIDEST = 30.0  # ratio at which the axis ends; what lies beyond is drawn as an arrow at its end
LINEAR = 2.0  # ratio up to which the axis is linear
COLOURS = {  # grey: not fitted
    EstimateStatus.FITTED: "C0", EstimateStatus.IN_A_SUM: "C1", EstimateStatus.AT_BOUND: "C3",
}  # fmt: skip


def forest(estimates: Sequence[ParameterEstimate]) -> Figure:
    """One row per parameter: identified over the drive file's value, and the numbers beside it.

    Where there is no positive ratio (a value of zero, or of another sign) the row has only its numbers.
    """
    rows = list(reversed(estimates))  # the first on top
    figure, axis = new_figure(1, 1, width=10.0, height=0.9 + 0.3 * len(rows))
    axis.axvline(1.0, color="k", lw=0.8)
    reach = 1.05
    for k, one in enumerate(rows):
        reach = max(reach, _mark(axis, k, one))
        axis.annotate(
            _numbers(one), (1.01, k), xycoords=("axes fraction", "data"), va="center", fontsize=8,
            color="k" if one.status in COLOURS else "0.5",
        )  # fmt: skip
    if reach > LINEAR:
        axis.set(xscale="log", xlim=(reach**-1.1, reach**1.1))
        plain_logarithmic(axis.xaxis)
    else:
        axis.set_xlim(1.0 - 1.1 * (reach - 1.0), 1.0 + 1.1 * (reach - 1.0))
    axis.set(ylim=(-0.6, len(rows) - 0.4), xlabel="identified over the drive file's value, 95 % intervals")
    axis.set_yticks(range(len(rows)), [one.name for one in rows], fontsize=8)
    for label, one in zip(axis.get_yticklabels(), rows, strict=True):
        label.set_color("k" if one.status in COLOURS else "0.5")
    return figure


def _mark(axis: Axes, k: int, one: ParameterEstimate) -> float:
    """Draw one row; returns the ratio, or its inverse, to which it reaches."""
    if one.believed == 0 or one.value / one.believed <= 0:
        return 1.0
    known = [one.low, one.value, one.high] if np.isfinite([one.low, one.high]).all() else [one.value] * 3
    low, ratio, high = sorted(np.array(known) / one.believed)
    middle, left, right = (float(np.clip(value, 1.0 / WIDEST, WIDEST)) for value in (ratio, low, high))
    shape = "o" if one.status in COLOURS else "x"
    if middle != ratio:
        shape = ">" if ratio > middle else "<"
    arms = [[middle - left], [right - middle]]
    axis.errorbar(middle, k, xerr=arms, fmt=shape, color=COLOURS.get(one.status, "0.65"), capsize=3, ms=5)
    return max(right, 1.0 / left)


def _numbers(one: ParameterEstimate) -> str:
    unit, found = one.unit.replace("*", " "), str(one.status)
    if one.status is EstimateStatus.FITTED:
        found = "{} {unit} ({})".format(*interval(one.value, one.low, one.high), unit=unit)
    elif one.status in COLOURS:
        found = f"{shown(one.value)} {unit}, {one.status}"
    return f"{found}; file {shown(one.believed)}"
