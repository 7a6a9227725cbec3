"""The cost of the searches over simulations and over time, to zoom into."""

import numpy as np

from experiments.reports.page.chart import Chart, Line, Panel
from tuning.optimisation.evolution import HistoryEntry

MIN_EXCESS = 1e-6  # so that the best can be drawn on a logarithmic axis


def evolution_chart(histories: dict[str, list[list[HistoryEntry]]], best: float, caption: str) -> Chart:
    """The same to zoom into, a line for each run."""
    panels = [
        Panel(label, "cost above the best, %", [
            Line(f"{name} {k + 1}", np.array([entry[column] for entry in history]), excess(history, best))
            for name, runs in histories.items()
            for k, history in enumerate(runs)
        ], log_x=True, log_y=True)
        for label, column in (("simulations (count)", 0), ("time, s", 1))
    ]  # fmt: skip
    return Chart(caption, panels)


def excess(history: list[HistoryEntry], best: float) -> np.ndarray:
    """How far the costs of a search are above the best, in per cent."""
    return 100.0 * (np.array([entry[2] for entry in history]) / best - 1.0 + MIN_EXCESS)
