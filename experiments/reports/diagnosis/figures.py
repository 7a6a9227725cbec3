"""The figures of `diffdrive diagnose`: the ladder, the missing force, where it lies, and the causes."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from diffdrive.logs import Log
from experiments.reports.charts.missing_force import GAPS, of_diagnosis, of_log, over_the_time
from experiments.reports.page.chart import Line, thinned
from experiments.reports.page.plotly import FEW
from experiments.reports.report import Report
from experiments.reports.theme import BLUE, DASHES, REFERENCE, drawing, legend_below, new_figure, say
from tuning.diagnosis.diagnose import Diagnosis
from tuning.diagnosis.gap.where import SIGNIFICANT
from tuning.diagnosis.judgement.ladder import ModelComparison

MOST_POINTS = 6000  # of a signal in a figure
REGIONS, CAUSES = 12, 8
BEFORE, AFTER = "0.6", BLUE
LESS: dict[str, Any] = {
    "facecolor": BEFORE,
    "hatch": "////",
    "edgecolor": "white",
}  # bars that differ in grey print, too
ROOM = 1.8  # times the largest value, above it, and below the least


def save_diagnosis_figures(report: Report, found: Diagnosis, logs: Sequence[Log]) -> None:
    """Save every figure."""
    on = found.split.says
    report.figure("ladder", _ladder(found), (
        f"Gap of each model, {on}, beside the noise floor: missing force and, simulated, position and command; bars: "
        "95 % intervals."
    ))  # fmt: skip
    log = logs[found.split.logs[-1]].name
    report.figure("missing_force", _missing(found, logs), f"Missing force, {log}: {on} ({GAPS}).")
    if (chart := of_diagnosis(found, logs)) is not None:
        report.chart("missing_force", chart)
    report.figure(
        "where",
        _where(found),
        ("Where the gap lies: the share of it at each place, beside the share that chance would give."),
    )
    if found.verdict.beliefs:
        report.figure("causes", _causes(found), "How sure each cause of the gap is: its confidence.")


@drawing
def _ladder(found: Diagnosis) -> Figure:
    """The gap of each model on held-out data, against the floor: the missing force and, simulated, the closed loop."""
    rms = np.array([comparison.force.rms if comparison.force.is_known else np.nan for comparison in found.comparisons])
    spread = np.abs(np.array([comparison.interval for comparison in found.comparisons]).T - rms)
    loops = [comparison.loop for comparison in found.comparisons if comparison.loop is not None]
    simulated = [one for one in loops if not one.says]
    figure, axes = new_figure(1, 3 if simulated else 1, height=3.2, share_x=False)
    axes = np.atleast_1d(axes)
    axes[0].set_ylabel("missing force RMS, N")
    _points(axes[0], rms, np.nan if found.floor is None else found.floor, "not computed", spread)
    for axis, scale, signal, unit in zip(axes[1:], (1e6, 1.0), ("position", "command"), ("µm", "N"), strict=False):
        of_loops = [np.nan if one.says else scale * getattr(one, f"{signal}_rms") for one in loops]
        axis.set(ylabel=f"{signal} RMS, {unit}", title="in closed loop")
        _points(axis, np.array(of_loops), scale * getattr(simulated[-1], f"{signal}_floor"), "runs away")
    for axis in axes:
        axis.set_xticks(
            np.arange(len(rms)), [comparison.name for comparison in found.comparisons], rotation=20, ha="right"
        )
        axis.set_xlim(-0.5, len(rms) - 0.5)
    legend_below(figure, axes[0])
    known = [
        (comparison.name, value) for comparison, value in zip(found.comparisons, rms, strict=True) if np.isfinite(value)
    ]
    gap = "no model's filter determines it" if not known else f"{known[0][1]:.3g} N RMS {known[0][0]}"
    gap += "" if len(known) < 2 else f", {known[-1][1]:.3g} N {known[-1][0]}"
    floor = "" if found.floor is None else f" (noise floor {found.floor:.3g} N)"
    say(figure, f"The missing force, {found.split.says}: {gap}{floor}")
    return figure


def _points(axis: Axes, values: np.ndarray, floor: float, why: str, spread: np.ndarray | None = None) -> None:
    """One value for each model, with its error bar, on a logarithmic axis; of one that is nan it is said `why`."""
    at, good = np.arange(len(values)), [one for one in (floor, *values) if np.isfinite(one)]
    axis.errorbar(at, values, yerr=spread, fmt="o", color=AFTER, capsize=4)
    axis.axhline(floor, ls=DASHES[1], label="noise floor", **REFERENCE)
    if good:
        axis.set_yscale("log")
        axis.set_ylim(min(good) / ROOM, max(good) * ROOM)
        axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axis.yaxis.set_minor_formatter(NullFormatter())
    for k, value in enumerate(values):
        if np.isfinite(value):
            text = axis.annotate(f"{value:.3g}", (k, value), xytext=(0, 8), textcoords="offset points", ha="center")
            text.set_bbox({"facecolor": "white", "edgecolor": "none", "pad": 0.5})  # the floor may pass through it
        else:
            axis.text(k, 0.97, why, transform=axis.get_xaxis_transform(), rotation=90, ha="center", va="top")


@drawing
def _missing(found: Diagnosis, logs: Sequence[Log]) -> Figure:
    """The force that is missing over time and position, and within the period that was found; before and after."""
    log = found.split.logs[-1]
    repeats = _period(found, log)
    figure, axes = new_figure(2 if repeats is None else 3, 1, height=2.2, share_x=False)
    for comparison, label, color in (one for one in _first_and_last(found.comparisons) if one[0].force.is_known):
        time, position, force = of_log(found, comparison, log)
        line = Line(label, *over_the_time(time, force))
        axes[0].plot(*thinned(line, MOST_POINTS), color=color, linewidth=0.8, label=label)
        known = np.flatnonzero(np.isfinite(force))
        some = known[:: max(1, known.size // MOST_POINTS)]
        size = 4.0 if some.size < FEW else 1.5
        axes[1].plot(position[some], force[some], ".", color=color, markersize=size)
        if repeats is not None:
            axes[2].plot(np.mod(position[some], repeats[0]), force[some], ".", color=color, markersize=size)
    axes[0].set_xlabel("time, s")
    axes[1].set_xlabel("position, mm")
    if repeats is not None:
        axes[2].set_xlabel("position within a period of {:.5g} mm ({}), mm".format(*repeats))
    for axis in axes:
        axis.set_ylabel("missing force, N")
    legend_below(figure, axes[0])
    axes[0].set_title(GAPS)
    shares = [
        f"{one.force.rms:.3g} N RMS {label}"
        for one, label, _ in _first_and_last(found.comparisons)
        if one.force.is_known
    ]
    say(figure, f"Missing force, {logs[log].name}: {', '.join(shares) or 'the filter of 0 models could tell it'}")
    return figure


def _period(found: Diagnosis, log: int) -> tuple[float, str] | None:
    """The travel (mm) after which the first effect found that repeats does so, and its name."""
    model = found.found.model
    added = list(zip(model.members, model.values(found.found.theta), strict=True))[len(model.members) - model.added :]
    for member, values in added:
        for name in ("period", "lead"):
            if name in values:
                return 1e3 * float(values[name][log]), member.candidate.effect.name
    return None


def _first_and_last(comparisons: Sequence[ModelComparison]) -> list[tuple[ModelComparison, str, str]]:
    """Recalibrated and, if there is anything, with what was found: each with its label and colour."""
    last = [(comparisons[-1], "with what was found", AFTER)] if len(comparisons) > 2 else []
    return [(comparisons[1], "recalibrated", BEFORE), *last]


@drawing
def _where(found: Diagnosis) -> Figure:
    """Shares of the gap beside the shares of the time."""
    significant = [one for one in found.where if one.dimension not in ("subsystem", "signal")]
    significant = [one for one in significant if one.p_value < SIGNIFICANT][:REGIONS] or significant[:REGIONS]
    figure, axis = new_figure(height=1.3 + 0.3 * max(len(significant), 3))
    at = np.arange(len(significant))[::-1]
    axis.barh(at + 0.2, [100 * one.share for one in significant], 0.4, color=AFTER, label="of the gap")
    axis.barh(at - 0.2, [100 * one.expected for one in significant], 0.4, label="expected by chance", **LESS)
    axis.set_yticks(at, [f"{one.dimension}: {one.region}" for one in significant])
    axis.set_xlabel("share, %")
    legend_below(figure)
    first = significant[0] if significant else None
    say(figure, "The gap is the same everywhere: 0 places stand out" if first is None else (
        f"{100 * first.share:.0f} % of the gap lies at {first.dimension} {first.region}, "
        f"{100 * first.expected:.0f} % would by chance"
    ))  # fmt: skip
    return figure


@drawing
def _causes(found: Diagnosis) -> Figure:
    """How sure each cause is."""
    beliefs = found.verdict.beliefs[:CAUSES]
    figure, axis = new_figure(height=1.3 + 0.3 * max(len(beliefs), 3))
    at = np.arange(len(beliefs))[::-1]
    for chosen, look, label in (
        (True, {"color": AFTER}, "part of the explanation"),
        (False, LESS, "not part of it"),
    ):
        some = [k for k, one in enumerate(beliefs) if bool(one.found) is chosen]
        if some:
            bars = axis.barh(at[some], [beliefs[k].confidence for k in some], label=label, **look)
            axis.bar_label(bars, fmt="%.2f", padding=3)
    rounds = any(one.round for one in beliefs)
    axis.set_yticks(at, [f"{one.effect} (round {one.round + 1})" if rounds else one.effect for one in beliefs])
    axis.set(xlim=(0, 1.1), xlabel="confidence (0 to 1)")
    legend_below(figure)
    first = max(beliefs, key=lambda one: one.confidence)
    say(figure, f"Most likely cause: {first.effect}, confidence {first.confidence:.2f}")
    return figure
