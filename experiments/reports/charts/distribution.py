"""How the error of a sweep is distributed over its machines."""

from collections.abc import Sequence

import numpy as np

from experiments.reports.page.chart import Chart, Line, Panel
from tuning.sweeps.summary import ERRORS, Group


def distribution_chart(groups: Sequence[Group], tolerance: float | None, by: str) -> Chart | None:
    """The share of the machines with at most that error, a line for each controller; None where all diverged."""
    lines = []
    for group in groups:
        errors = 1e6 * group.error(by)
        at = np.sort(errors[np.isfinite(errors) & (errors > 0.0)])  # an axis of logarithms has no zero
        below = np.searchsorted(np.sort(errors), at, side="right")
        if at.size:
            lines.append(Line(group.controller, at, 100.0 * below / len(errors), "steps"))
    if not lines:
        return None
    if tolerance is not None:
        lines.append(Line("tolerance", np.full(2, 1e6 * tolerance), np.array([0.0, 100.0])))
    caption = f"Share of the machines with at most that {ERRORS[by]}, {groups[0].motion}; further left is better."
    return Chart(caption, [Panel(f"{ERRORS[by]}, µm", "machines, %", lines, log_x=True)])
