"""Parameters and their intervals relative to what the drive file says: a forest plot."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from experiments.reports.readable import interval, shown
from experiments.reports.theme import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    REFERENCE,
    SMALL,
    VERMILION,
    drawing,
    legend_below,
    new_figure,
    plain_logarithmic,
    say,
)
from tuning.identification.estimates import EstimateStatus, ParameterEstimate

WIDEST = 30.0  # ratio at which the axis ends; what lies beyond is drawn as an arrow at its end
LINEAR = 2.0  # ratio up to which the axis is linear
LOOKS = {  # of what was fitted; the rest is grey
    EstimateStatus.FITTED: (BLUE, "o"), EstimateStatus.IN_A_SUM: (ORANGE, "s"),
    EstimateStatus.AT_BOUND: (VERMILION, "D"),
}  # fmt: skip
STATED, NOT_FITTED = (GREY, "+"), (GREY, "x")


@drawing
def forest(estimates: Sequence[ParameterEstimate]) -> Figure:
    """One row per parameter: identified over the drive file's value, and the numbers beside it.

    Where there is no positive ratio (a value of zero, or of another sign) the row has only its numbers.
    """
    rows = list(reversed(estimates))  # the first on top
    figure, axis = new_figure(height=1.3 + 0.25 * len(rows))
    axis.axvline(1.0, **REFERENCE)
    reach = 1.05
    for k, one in enumerate(rows):
        reach = max(reach, _mark(axis, k, one))
        axis.annotate(
            _numbers(one), (1.01, k), xycoords=("axes fraction", "data"), va="center", fontsize=SMALL,
            color=BLACK if one.status in LOOKS else GREY,
        )  # fmt: skip
    if reach > LINEAR:
        axis.set(xscale="log", xlim=(reach**-1.1, reach**1.1))
        plain_logarithmic(axis.xaxis)
    else:
        axis.set_xlim(1.0 - 1.1 * (reach - 1.0), 1.0 + 1.1 * (reach - 1.0))
    axis.set(ylim=(-0.6, len(rows) - 0.4), xlabel="identified over the drive file's value, 95 % intervals (ratio)")
    axis.set_yticks(range(len(rows)), [one.name for one in rows])
    for label, one in zip(axis.get_yticklabels(), rows, strict=True):
        label.set_color(BLACK if one.status in LOOKS else GREY)
    drawn = [one.status for one in rows if _has_ratio(one)]
    looks = {str(status): _look(status) for status in dict.fromkeys(drawn)}
    legend_below(figure, handles=[
        Line2D([], [], color=colour, marker=shape, ls="", label=label) for label, (colour, shape) in looks.items()
    ])  # fmt: skip
    fitted = [one for one in rows if one.status is EstimateStatus.FITTED]
    moved = [one for one in fitted if not one.low <= one.believed <= one.high]
    say(
        figure,
        f"{len(fitted)} of {len(rows)} parameters fitted; of {len(moved)} the drive file's value is outside "
        "the 95 % interval",
    )
    return figure


def _look(status: EstimateStatus) -> tuple[str, str]:
    return STATED if status is EstimateStatus.FIXED else LOOKS.get(status, NOT_FITTED)


def _has_ratio(one: ParameterEstimate) -> bool:
    return one.believed != 0 and one.value / one.believed > 0


def _mark(axis: Axes, k: int, one: ParameterEstimate) -> float:
    """Draw one row; returns the ratio, or its inverse, to which it reaches."""
    if not _has_ratio(one):
        return 1.0
    known = [one.low, one.value, one.high] if np.isfinite([one.low, one.high]).all() else [one.value] * 3
    low, ratio, high = sorted(np.array(known) / one.believed)
    middle, left, right = (float(np.clip(value, 1.0 / WIDEST, WIDEST)) for value in (ratio, low, high))
    colour, shape = _look(one.status)
    if middle != ratio:
        shape = ">" if ratio > middle else "<"
    arms = [[middle - left], [right - middle]]
    axis.errorbar(middle, k, xerr=arms, fmt=shape, color=colour, capsize=3, ms=5)
    return max(right, 1.0 / left)


def _numbers(one: ParameterEstimate) -> str:
    unit, found = one.unit.replace("*", " "), str(one.status)
    if one.status is EstimateStatus.FITTED:
        found = "{} {unit} ({})".format(*interval(one.value, one.low, one.high), unit=unit)
    elif one.status in LOOKS:
        found = f"{shown(one.value)} {unit}, {one.status}"
    return f"{found}; file {shown(one.believed)}"
