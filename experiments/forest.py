"""Parameters and their intervals relative to what the drive file says: a forest plot."""

from collections.abc import Sequence
from typing import Any

from experiments.report import new_figure
from tuning.estimates import Estimate

WIDEST = 30.0  # ratio, at which an interval is cut off


def forest(estimates: Sequence[Estimate]) -> Any:
    """One row per parameter: identified over the drive file's value, on a logarithmic axis; those not fitted are grey.

    Where there is no positive ratio (a value of zero, or of another sign) the row has only its numbers.
    """
    rows = list(reversed(estimates))  # the first on top
    figure, axis = new_figure(1, 1, width=10.0, height=0.9 + 0.3 * len(rows))
    axis.axvline(1.0, color="k", lw=0.8)
    for k, one in enumerate(rows):
        fitted = one.status in ("fitted", "at its bound")
        shade = {"fitted": "C0", "at its bound": "C3"}.get(one.status, "0.65")
        if one.believed != 0 and one.value / one.believed > 0:
            ratio = one.value / one.believed
            ends = sorted((one.low / one.believed, one.high / one.believed))
            low, high = max(ends[0], ratio / WIDEST), min(ends[1], ratio * WIDEST)
            arms = [[max(0.0, ratio - low)], [max(0.0, high - ratio)]]
            axis.errorbar(ratio, k, xerr=arms, fmt="o" if fitted else "x", color=shade, capsize=3, ms=5)
        said = f"{one.value:.5g} [{one.low:.5g}, {one.high:.5g}] {one.unit}" if fitted else one.status
        axis.annotate(
            f"{said}  (file: {one.believed:.4g})",
            (1.01, k),
            xycoords=("axes fraction", "data"),
            va="center",
            fontsize=8,
            color="k" if fitted else "0.5",
        )
    axis.set(
        xscale="log", ylim=(-0.6, len(rows) - 0.4), xlabel="identified over the drive file's value, 95 % intervals"
    )
    axis.set_yticks(range(len(rows)), [one.name for one in rows], fontsize=8)
    for label, one in zip(axis.get_yticklabels(), rows, strict=True):
        label.set_color("k" if one.status in ("fitted", "at its bound") else "0.5")
    low, high = axis.get_xlim()
    reach = max(high, 1.0 / low, 1.1)
    axis.set_xlim(1.0 / reach, reach)
    if reach < 5.0:  # the axis spans no decade to mark
        axis.xaxis.set_major_formatter("{x:.3g}")
        axis.xaxis.set_minor_formatter("{x:.3g}")
        axis.tick_params(axis="x", which="both", labelsize=8)
    return figure
