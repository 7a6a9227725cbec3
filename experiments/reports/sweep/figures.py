"""The figures of a sweep."""

import itertools
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from experiments.reports.theme import (
    BLUE,
    COLOURS,
    PALE,
    REFERENCE,
    VERMILION,
    drawing,
    legend_below,
    new_figure,
    plain_logarithmic,
    say,
    style,
)
from tuning.sweeps.sensitivity import Influence
from tuning.sweeps.summary import ERRORS, LEVEL, Group, exceedance, quantile

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_POINTS = 4000  # of a cloud: more are a blot
FEW_POINTS = 500  # of a cloud, below which each is drawn larger
LEAST = 1e-12  # m, where a figure begins if no machine has an error at all
HIGH = 0.95  # of the machines of a bin lie below its upper line
# machines of a bin: of fewer, even the largest may lie below that line too often for it to bound the interval above
ENOUGH = math.ceil(math.log(0.5 * (1.0 - LEVEL)) / math.log(HIGH))
MOST_BINS = 12  # each then half an inch wide: its steps and its interval are seen


@drawing
def distribution(groups: Sequence[Group], tolerance: float | None, by: str) -> "Figure":
    """How the error is distributed over the machines, a curve for each controller; lower and further left is better."""
    figure, axis = new_figure(height=3.4)
    start, edge = _ends(groups, tolerance, by)
    for k, group in enumerate(groups):
        errors = np.sort(1e6 * group.error(by))
        shares = 100.0 * np.arange(1, len(errors) + 1) / len(errors)
        good = np.isfinite(errors)
        at, below = np.maximum(errors[good], 1e6 * start), shares[good]
        if not good.all():  # goes on below 100 %, to the edge
            at, below = np.append(at, 1e6 * edge), np.append(below, 100.0 * np.mean(good))
        if not good.any():
            at, below = 1e6 * np.array([start, edge]), np.zeros(2)
        axis.step(at, below, where="post", label=_label(group), **style(k))
    _tolerance(axis, tolerance)
    axis.set(xscale="log", xlabel=f"{ERRORS[by]}, µm", ylabel="machines with at most that, %")
    plain_logarithmic(axis.xaxis)
    legend_below(figure)
    say(figure, f"{groups[0].motion}: {_median(groups, by) if tolerance is None else _missed(groups, tolerance, by)}")
    return figure


@drawing
def exceedance_figure(groups: Sequence[Group], tolerance: float | None, by: str) -> "Figure":
    """How probable it is that a machine misses a tolerance, over the tolerance, with its 95 % interval."""
    figure, axis = new_figure(height=3.4)
    start, edge = _ends(groups, tolerance, by)
    for k, group in enumerate(groups):
        errors = group.error(by)
        finite = errors[np.isfinite(errors)]
        first = np.min(finite) if finite.size else start
        last = edge if finite.size < errors.size else np.max(finite) * 1.05  # who diverged misses any tolerance
        at = np.geomspace(max(first, start), max(last, start), 80)
        exceedances = [exceedance(errors, one) for one in at]
        axis.plot(1e6 * at, [100 * one.value for one in exceedances], label=_label(group), **style(k))
        low, high = ([100 * end for end in ends] for ends in zip(*(one[1:] for one in exceedances), strict=True))
        axis.fill_between(1e6 * at, low, high, color=style(k)["color"], alpha=0.2, lw=0)
    _tolerance(axis, tolerance)
    least = 100.0 / (2.0 * len(groups[0].table))
    axis.set(
        xscale="log", yscale="log", ylim=(least, 110.0), xlabel=f"tolerance on the {ERRORS[by]}, µm",
        ylabel="machines that miss it, %",
    )  # fmt: skip
    axis.set_title(f"shaded: {100 * LEVEL:g} % intervals")
    plain_logarithmic(axis.xaxis)
    plain_logarithmic(axis.yaxis)
    legend_below(figure)
    say(figure, f"{groups[0].motion}: {_median(groups, by) if tolerance is None else _missed(groups, tolerance, by)}")
    return figure


@drawing
def error_against(groups: Sequence[Group], name: str, unit: str, tolerance: float | None, by: str) -> "Figure":
    """The error over a quantity that varies: each machine, and median and 95 % of bins of equally many machines.

    Each bin is drawn as wide as it is, with the 95 % intervals of both, which say what so few machines can tell.
    Machines that diverged are crosses at the upper edge; a line ends where its error is infinite.
    """
    figure, axis = new_figure(height=3.8)
    start, _ = _ends(groups, tolerance, by)  # where machines without any error are drawn
    scale, shown = _readable(unit, np.max(np.abs(groups[0].column(name))))
    found, count = [], 0
    for k, group in enumerate(groups):
        values, errors = scale * group.column(name), 1e6 * np.maximum(group.error(by), start)
        good, colour = np.isfinite(errors), COLOURS[k]
        some = np.flatnonzero(good)[:MOST_POINTS]
        few = some.size < FEW_POINTS
        axis.plot(values[some], errors[some], ".", ms=4 if few else 2, mew=0, alpha=0.4 if few else 0.25, color=colour)
        lost = np.flatnonzero(~good)[:MOST_POINTS]
        if lost.size:
            edge = np.full(lost.size, 1.0 - 0.03 * k)
            axis.plot(values[lost], edge, "x", ms=4, alpha=0.5, color=colour, transform=axis.get_xaxis_transform(),
                      clip_on=False, label=f"{group.controller}: diverged")  # fmt: skip
        edges, bins = _bins(values, errors)
        count = len(bins[0])
        for share, weight, what in ((0.5, 1.8, "median"), (HIGH, 0.9, f"{100 * HIGH:g} % of them")):
            if share == HIGH and count < ENOUGH:
                continue
            middle, low, high = _quantiles(bins, share)
            axis.step(edges, np.append(middle, middle[-1]), where="post", color=colour, ls=style(k)["ls"], lw=weight,
                      label=f"{group.controller}: {what}")  # fmt: skip
            low, high = (np.append(ends, ends[-1]) for ends in (low, high))
            axis.fill_between(edges, low, high, step="post", color=colour, alpha=0.2, lw=0)
            if share == 0.5 and np.isfinite(middle[[0, -1]]).all():
                found.append(f"{middle[0]:.3g} to {middle[-1]:.3g} µm ({group.controller})")
    _tolerance(axis, tolerance, horizontal=True)
    axis.set(yscale="log", xlabel=f"{name}, {shown}", ylabel=f"{ERRORS[by]}, µm")
    axis.set_title(f"each dot a machine; lines: bins of {count} machines, shaded their {100 * LEVEL:g} % intervals")
    plain_logarithmic(axis.yaxis)
    legend_below(figure)
    ends = f"from {_rounded(edges)[0]} to {_rounded(edges)[1]} {shown} of {name}"
    say(figure, f"{groups[0].motion}: median {ERRORS[by]} {', '.join(found) or 'infinite at an end,'} {ends}")
    return figure


def _rounded(edges: np.ndarray) -> tuple[str, str]:
    """Both ends to a hundredth of what lies between them: digits beyond are of the draw."""
    digits = 1 - math.floor(math.log10(max(float(edges[-1] - edges[0]), 1e-300)))
    low, high = (round(float(end), digits) for end in (edges[0], edges[-1]))
    return f"{low:.4g}", f"{high:.4g}"


def _median(groups: Sequence[Group], by: str) -> str:
    """The title where there is no tolerance."""
    return f"median {ERRORS[by]} " + ", ".join(
        f"{1e6 * quantile(one.error(by), 0.5).value:.3g} µm ({one.controller})" for one in groups
    )


def _missed(groups: Sequence[Group], tolerance: float, by: str) -> str:
    """The title where there is one."""
    shares = (f"{100 * exceedance(one.error(by), tolerance).value:.3g} % ({one.controller})" for one in groups)
    return f"a {ERRORS[by]} of {1e6 * tolerance:.3g} µm is missed by {', '.join(shares)}"


def _ends(groups: Sequence[Group], tolerance: float | None, by: str) -> tuple[float, float]:
    """From which error to which a figure goes (m)."""
    errors = np.concatenate([group.error(by) for group in groups])
    limits = np.append(errors[np.isfinite(errors) & (errors > 0.0)], [] if tolerance is None else tolerance)
    limits = limits if limits.size else np.array([LEAST])
    return float(np.min(limits)), 1.3 * float(np.max(limits))


def _label(group: Group) -> str:
    return f"{group.controller}, all diverged" if group.diverged.all() else group.controller


def _readable(unit: str, largest: float) -> tuple[float, str]:
    """A factor, and the unit that it leads to: kN, N/µm, mm, ms where plain ones would have many zeros."""
    if unit == "N/m" and largest >= 1e6:
        return 1e-6, "N/µm"
    if unit == "N" and largest >= 2e3:
        return 1e-3, "kN"
    return (1e3, f"m{unit}") if unit in ("m", "m/s", "s") and largest < 0.1 else (1.0, unit)


def _bins(values: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, list[np.ndarray]]:
    """Errors in bins of equally many machines, enough of them each, and the edges of the bins."""
    order = np.argsort(values, kind="stable")
    parts = np.array_split(order, min(MOST_BINS, max(1, len(order) // ENOUGH)))
    between = [0.5 * (values[left[-1]] + values[right[0]]) for left, right in itertools.pairwise(parts)]
    edges = np.array([values[order[0]], *between, values[order[-1]]])
    return edges, [errors[part] for part in parts]


def _quantiles(bins: Sequence[np.ndarray], share: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A quantile of each bin and its interval; NaN where it is infinite, or the machines are too few to bound it."""
    found = [[np.nan if end is None else end for end in quantile(one, share)] for one in bins]
    value, low, high = np.where(np.isfinite(found), found, np.nan).T
    return value, low, high


@drawing
def tornado(found: Sequence[Influence], group: Group, by: str) -> "Figure":
    """What each quantity does to the error, the strongest on top."""
    from matplotlib.patches import Patch

    figure, axis = new_figure(height=1.5 + 0.28 * len(found))
    errors = group.error(by)
    middle = 1e6 * float(np.exp(np.mean(np.log(errors[np.isfinite(errors) & (errors > 0.0)]))))
    looks: dict[str, dict[str, Any]] = {
        "quantity low": {"facecolor": BLUE, "edgecolor": "white"},
        "quantity high": {"facecolor": VERMILION, "edgecolor": "white", "hatch": "////"},
    }
    chance = {"facecolor": PALE, "edgecolor": "white"}
    for row, one in enumerate(reversed(found)):
        for end, look, side in ((one.low, looks["quantity low"], 0.15), (one.high, looks["quantity high"], -0.15)):
            shown = look if one.is_significant else chance
            axis.barh(row + side, 1e6 * end - middle, left=middle, height=0.3, **shown)
        edge = max(1e6 * one.low, 1e6 * one.high, middle)
        axis.annotate(f" {100 * one.share:.0f} %", (edge, row), va="center")
    axis.axvline(middle, **REFERENCE)
    axis.set_yticks(range(len(found)), [one.name for one in reversed(found)])
    axis.set_title("the percentage is the share of the variance")
    axis.set(xlabel=f"mean {ERRORS[by]}, µm")
    axis.margins(x=0.12)
    looks["within chance"] = chance
    legend_below(figure, handles=[Patch(label=label, **look) for label, look in looks.items()])
    first = found[0]
    what = (
        "no quantity is beyond chance"
        if not first.is_significant
        else (
            f"{first.name} makes {100 * first.share:.0f} % of the variance, "
            f"{1e6 * first.low:.3g} to {1e6 * first.high:.3g} µm"
        )
    )
    say(figure, f"{group.controller}, {group.motion}: mean {ERRORS[by]} {middle:.3g} µm; {what}")
    return figure


def _tolerance(axis: "Axes", tolerance: float | None, horizontal: bool = False) -> None:
    if tolerance is not None:
        draw = axis.axhline if horizontal else axis.axvline
        draw(1e6 * tolerance, ls=":", label=f"tolerance {1e6 * tolerance:.3g} µm", **{**REFERENCE, "lw": 1.5})
