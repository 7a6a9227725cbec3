"""What motor minus table says along the stroke and over time, beside the model of it; the error at each reversal."""

import numpy as np

from diffdrive.logs.encoders.result import EncoderComparison
from experiments.reports.page.chart import Chart, Line, Panel

POSITION, TIME, DIFFERENCE = "position of the table, mm", "time, s", "motor - table, µm"


def encoders_chart(comparison: EncoderComparison) -> Chart:
    """The difference by direction, and the model; lost motion at each reversal, and along the stroke."""
    samples = comparison.samples
    panels = [Panel(POSITION, DIFFERENCE, _lines(comparison, 1e3 * samples.position))]
    errors = []
    if comparison.reversals:
        at, error = (np.array([getattr(one, name) for one in comparison.reversals]) for name in ("position", "error"))
        errors.append(Line("of each reversal", 1e3 * at, 1e6 * error, "points"))
    if comparison.places:
        middles = np.array([0.5 * (low + high) for low, high, _ in comparison.places])
        values = np.array([error.value for *_, error in comparison.places])
        errors.append(Line("along the stroke", 1e3 * middles, 1e6 * values, "points"))
    if errors:
        panels.append(Panel(POSITION, "reversal error, µm", errors))
    panels.append(Panel(TIME, DIFFERENCE, _lines(comparison, samples.time)))
    caption = f"Motor minus table along the stroke, by direction, and over time, beside its model: {comparison.log}."
    return Chart(caption, panels)


def _lines(comparison: EncoderComparison, x: np.ndarray) -> list[Line]:
    samples = comparison.samples
    lines = [  # blank in the other direction; points would be an element of the page each
        Line(name, x, np.where(there, 1e6 * samples.difference, np.nan))
        for name, side in (("forwards", 1.0), ("backwards", -1.0))
        if (there := samples.direction == side).any()
    ]
    return [*lines, Line("model", x, 1e6 * samples.fitted)]
