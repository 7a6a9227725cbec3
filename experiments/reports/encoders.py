"""Motor against scale: the table of what their difference holds, and its pictures along the stroke and over time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from diffdrive.logs.encoders.result import EncoderComparison
from experiments.reports import readable
from experiments.reports.charts.encoders import encoders_chart
from experiments.reports.report import Report, named_file
from experiments.reports.theme import BLACK, GREEN, SKY, VERMILION, drawing, legend_below, new_figure, say

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 20_000  # of a picture
LEAST_SPAN = 0.01  # µm of an axis: finer marks would be of rounding alone


def report_encoders(report: Report, comparisons: Sequence[EncoderComparison]) -> None:
    """Tables of all logs, a picture of each."""
    if not comparisons:
        return
    rows = [
        [one.log, name, *(factor * value for value in estimate), unit]
        for one in comparisons
        for name, estimate, factor, unit in one.rows()
    ]
    names = ("log", "motor against table", "value", "from", "to", "unit")
    notes = [
        "Backlash and wind-up add up to the reversal error. Wind-up per newton is that of the command while the axis "
        "accelerates: of the screw it is more, by the share of the moving mass that is not the table's."
    ]
    report.table("encoders", names, rows, "What motor minus table says, with 95 % intervals", notes=notes)
    reversals = [
        [one.log, time, 1e3 * position, 1e6 * error] for one in comparisons for time, position, error in one.reversals
    ]
    if reversals:
        report.record("encoder_reversals", ("log", "time s", "position mm", "reversal error um"), reversals)
    places = [
        [one.log, 1e3 * low, 1e3 * high, *(1e6 * value for value in error)]
        for one in comparisons
        for low, high, error in one.places
    ]
    if places:
        names = ("log", "from mm", "to mm", "reversal error um", "at least um", "at most um")
        report.record("encoder_places", names, places)
    for one in comparisons:
        name = "encoders" if len(comparisons) == 1 else f"encoders_{named_file(one.log)}"
        chart = encoders_chart(one)
        report.figure(name, encoders_figure(one), chart.caption)
        report.chart(name, chart)


@drawing
def encoders_figure(comparison: EncoderComparison) -> "Figure":
    """Motor minus table against position, by direction, and against time; the model; each reversal's lost motion."""
    samples = comparison.samples
    thinned = slice(None, None, 1 + len(samples.time) // MOST_POINTS)
    time, direction = samples.time[thinned], samples.direction[thinned]
    position, difference, fitted = (
        factor * one[thinned]
        for factor, one in ((1e3, samples.position), (1e6, samples.difference), (1e6, samples.fitted))
    )
    has_errors = bool(comparison.reversals or comparison.places)
    figure, axes = new_figure(3 if has_errors else 2, 1, height=2.4, share_x=False)
    for axis, x, label in ((axes[0], position, "position of the table, mm"), (axes[1], time, "time, s")):
        for side, name, colour, mark in ((1.0, "forwards", SKY, "o"), (-1.0, "backwards", VERMILION, "s")):
            there = direction == side
            if there.any():
                axis.plot(x[there], difference[there], mark, ms=1.5, mew=0, color=colour, label=name)
        axis.plot(x, fitted, "o", ms=1, mew=0, color=BLACK, label="model")
        axis.set(xlabel=label, ylabel="motor - table, µm")
    if comparison.reversals:
        places = np.array([one.position for one in comparison.reversals])
        errors = np.array([one.error for one in comparison.reversals])
        axes[2].plot(1e3 * places, 1e6 * errors, "D", ms=4, color=GREEN, label="of each reversal")
    if comparison.places:
        middle = np.array([0.5 * (low + high) for low, high, _ in comparison.places])
        values = np.array([error.value for _, _, error in comparison.places])
        halves = np.array([error.half_width for _, _, error in comparison.places])
        bars = (1e3 * middle, 1e6 * values, 1e6 * halves)
        axes[2].errorbar(*bars, fmt="s", color=BLACK, capsize=3, label="along the stroke, 95 % intervals")
    if has_errors:
        axes[2].set(xlabel="position of the table, mm", ylabel="reversal error, µm")
        axes[2].ticklabel_format(axis="y", useOffset=False)
        low, high = axes[2].get_ylim()
        if high - low < LEAST_SPAN:
            axes[2].set_ylim(0.5 * (low + high - LEAST_SPAN), 0.5 * (low + high + LEAST_SPAN))
    legend_below(figure, markerscale=2)
    say(figure, readable.titled(readable.readable(comparison.headline())))
    return figure
