"""Motor against scale: the table of what their difference holds, and its pictures along the stroke and over time."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from diffdrive.logs.encoders.result import EncoderComparison
from experiments.reports.report import Report, named_file, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MOST_POINTS = 20_000  # of a picture


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
        report.figure(name, encoders_figure(one))


def encoders_figure(comparison: EncoderComparison) -> "Figure":
    """Motor minus table against position, by direction, and against time; the model; each reversal's lost motion."""
    samples = comparison.samples
    thinned = slice(None, None, 1 + len(samples.time) // MOST_POINTS)
    time, direction = samples.time[thinned], samples.direction[thinned]
    position, difference, fitted = (
        factor * one[thinned]
        for factor, one in ((1e3, samples.position), (1e6, samples.difference), (1e6, samples.fitted))
    )
    figure, axes = new_figure(3, 1, width=9.0, height=2.8, share_x=False)
    for axis, x, label in ((axes[0], position, "position of the table, mm"), (axes[1], time, "time, s")):
        for side, name, colour in ((1.0, "forwards", "C0"), (-1.0, "backwards", "C1")):
            there = direction == side
            axis.plot(x[there], difference[there], ".", ms=2, color=colour, label=name)
        axis.plot(x, fitted, ".", ms=1, color="k", label="model")
        axis.set(xlabel=label, ylabel="motor - table, µm")
    axes[0].legend(loc="upper right", markerscale=4)
    axes[0].set_title(comparison.headline().replace(" um", " µm"), fontsize=9)
    axis = axes[2]
    if comparison.reversals:
        places = np.array([one.position for one in comparison.reversals])
        errors = np.array([one.error for one in comparison.reversals])
        axis.plot(1e3 * places, 1e6 * errors, "o", color="C2", label="of each reversal")
    if comparison.places:
        middle = np.array([0.5 * (low + high) for low, high, _ in comparison.places])
        values = np.array([error.value for _, _, error in comparison.places])
        halves = np.array([error.half_width for _, _, error in comparison.places])
        axis.errorbar(1e3 * middle, 1e6 * values, 1e6 * halves, fmt="s", color="k", capsize=3, label="along the stroke")
    axis.set(xlabel="position of the table, mm", ylabel="reversal error, µm")
    if comparison.reversals or comparison.places:
        axis.legend(loc="best")
    return figure
