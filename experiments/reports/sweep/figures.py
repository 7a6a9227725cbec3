"""The figures of a sweep."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from experiments.reports.report import new_figure, plain_logarithmic
from tuning.sweeps.sensitivity import Influence
from tuning.sweeps.summary import ERRORS, Group, exceedance

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST_POINTS = 4000  # of a cloud: more are a blot
FEW_POINTS = 500  # of a cloud, below which each is drawn larger
BINS = 24
LEAST = 1e-12  # m, where a figure begins if no machine has an error at all


def distribution(groups: Sequence[Group], tolerance: float | None, by: str) -> "Figure":
    """How the error is distributed over the machines, a curve for each controller; lower and further left is better."""
    figure, axis = new_figure(width=8.0, height=4.0)
    start, edge = _ends(groups, tolerance, by)
    for group in groups:
        errors = np.sort(1e6 * group.error(by))
        shares = 100.0 * np.arange(1, len(errors) + 1) / len(errors)
        good = np.isfinite(errors)
        at, below = np.maximum(errors[good], 1e6 * start), shares[good]
        if not good.all():  # goes on below 100 %, to the edge
            at, below = np.append(at, 1e6 * edge), np.append(below, 100.0 * np.mean(good))
        if not good.any():
            at, below = 1e6 * np.array([start, edge]), np.zeros(2)
        axis.step(at, below, where="post", label=_label(group))
    _tolerance(axis, tolerance)
    axis.set(xscale="log", xlabel=f"{ERRORS[by]}, µm", ylabel="machines with at most that, %", title=groups[0].motion)
    plain_logarithmic(axis.xaxis)
    axis.legend(loc="lower right")
    return figure


def exceedance_figure(groups: Sequence[Group], tolerance: float | None, by: str) -> "Figure":
    """How probable it is that a machine misses a tolerance, over the tolerance, with its 95 % interval."""
    figure, axis = new_figure(width=8.0, height=4.0)
    start, edge = _ends(groups, tolerance, by)
    for group in groups:
        errors = group.error(by)
        finite = errors[np.isfinite(errors)]
        first = np.min(finite) if finite.size else start
        last = edge if finite.size < errors.size else np.max(finite) * 1.05  # who diverged misses any tolerance
        at = np.geomspace(max(first, start), max(last, start), 80)
        exceedances = [exceedance(errors, one) for one in at]
        line = axis.plot(1e6 * at, [100 * one.value for one in exceedances], label=_label(group))[0]
        low, high = ([100 * end for end in ends] for ends in zip(*(one[1:] for one in exceedances), strict=True))
        axis.fill_between(1e6 * at, low, high, color=line.get_color(), alpha=0.2, lw=0)
    _tolerance(axis, tolerance)
    least = 100.0 / (2.0 * len(groups[0].table))
    axis.set(
        xscale="log", yscale="log", ylim=(least, 110.0), xlabel=f"tolerance on the {ERRORS[by]}, µm",
        ylabel="machines that miss it, %", title=groups[0].motion,
    )  # fmt: skip
    plain_logarithmic(axis.xaxis)
    plain_logarithmic(axis.yaxis)
    axis.legend(loc="lower left")
    return figure


def error_against(groups: Sequence[Group], name: str, unit: str, tolerance: float | None, by: str) -> "Figure":
    """The error over a quantity that varies: each machine, and median and 95 % of a slice of them.

    Machines that diverged are crosses at the upper edge; a line ends where its error is infinite.
    """
    figure, axis = new_figure(width=8.0, height=4.0)
    start, _ = _ends(groups, tolerance, by)  # where machines without any error are drawn
    scale, shown = _readable(unit, np.max(np.abs(groups[0].column(name))))
    for k, group in enumerate(groups):
        values, errors = scale * group.column(name), 1e6 * np.maximum(group.error(by), start)
        good = np.isfinite(errors)
        some = np.flatnonzero(good)[:MOST_POINTS]
        few = some.size < FEW_POINTS
        axis.plot(values[some], errors[some], ".", ms=5 if few else 2, alpha=0.5 if few else 0.25, color=f"C{k}")
        lost = np.flatnonzero(~good)[:MOST_POINTS]
        if lost.size:
            edge = np.full(lost.size, 1.0 - 0.02 * k)
            axis.plot(values[lost], edge, "x", ms=4, alpha=0.5, color=f"C{k}", transform=axis.get_xaxis_transform(),
                      clip_on=False, label=f"{group.controller}: diverged")  # fmt: skip
        middles, medians, highs = _sliced(values, errors)
        axis.plot(middles, medians, color=f"C{k}", label=f"{group.controller}: median")
        axis.plot(middles, highs, "--", color=f"C{k}", label="95 %")
    _tolerance(axis, tolerance, horizontal=True)
    axis.set(yscale="log", xlabel=f"{name}, {shown}", ylabel=f"{ERRORS[by]}, µm", title=groups[0].motion)
    plain_logarithmic(axis.yaxis)
    axis.legend(fontsize=8)
    return figure


def _ends(groups: Sequence[Group], tolerance: float | None, by: str) -> tuple[float, float]:
    """From which error to which a figure goes (m)."""
    errors = np.concatenate([group.error(by) for group in groups])
    limits = np.append(errors[np.isfinite(errors) & (errors > 0.0)], [] if tolerance is None else tolerance)
    limits = limits if limits.size else np.array([LEAST])
    return float(np.min(limits)), 1.3 * float(np.max(limits))


def _label(group: Group) -> str:
    return f"{group.controller}, all diverged" if group.diverged.all() else group.controller


def _readable(unit: str, largest: float) -> tuple[float, str]:
    """A factor, and the unit that it leads to: kN, mm, ms where plain ones would have many zeros."""
    if unit == "N" and largest >= 2e3:
        return 1e-3, "kN"
    return (1e3, f"m{unit}") if unit in ("m", "m/s", "s") and largest < 0.1 else (1.0, unit)


def _sliced(values: np.ndarray, errors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Median and 95 % over slices of equally many machines."""
    order = np.argsort(values, kind="stable")
    slices = [part for part in np.array_split(order, min(BINS, max(1, len(order) // 16))) if len(part)]
    shares = [np.quantile(errors[part], (0.5, 0.95), method="inverted_cdf") for part in slices]
    medians, highs = np.where(np.isfinite(shares), shares, np.nan).T
    return np.array([np.mean(values[part]) for part in slices]), medians, highs


def tornado(found: Sequence[Influence], group: Group, by: str) -> "Figure":
    """What each quantity does to the error, the strongest on top."""
    figure, axis = new_figure(width=8.5, height=1.2 + 0.35 * len(found))
    errors = group.error(by)
    middle = 1e6 * float(np.exp(np.mean(np.log(errors[np.isfinite(errors) & (errors > 0.0)]))))
    for row, one in enumerate(reversed(found)):
        for end, colour, side in ((one.low, "C0", 0.15), (one.high, "C1", -0.15)):
            axis.barh(
                row + side, 1e6 * end - middle, left=middle, color=colour if one.is_significant else "0.8", height=0.3
            )
        edge = max(1e6 * one.low, 1e6 * one.high, middle)
        axis.annotate(f" {100 * one.share:.0f} %", (edge, row), va="center", fontsize=8)
    axis.axvline(middle, color="0.3", lw=0.8)
    axis.set_yticks(range(len(found)), [one.name for one in reversed(found)])
    axis.set(
        xlabel=f"mean {ERRORS[by]}, µm, where the quantity is low (blue), high (orange); grey: chance",
        title=f"{group.controller}, {group.motion}: share of the variance",
    )
    axis.margins(x=0.12)
    return figure


def _tolerance(axis: "Axes", tolerance: float | None, horizontal: bool = False) -> None:
    if tolerance is not None:
        draw = axis.axhline if horizontal else axis.axvline
        draw(1e6 * tolerance, color="0.3", ls=":", label="tolerance")
