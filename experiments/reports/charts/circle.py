"""The circular test of machines: by how much the radius deviates, over the angle."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from experiments.reports.page.chart import Chart, Line, Panel

SENSES = ("counter-clockwise", "clockwise")


def circle_chart(circles: Mapping[str, Float[np.ndarray, "2 t"]]) -> Chart:
    """Both senses of rotation, a line for each machine by its name; deviations in m."""
    panels = [
        Panel("angle, deg", f"radius, {sense}, µm", [
            Line(name, np.linspace(0.0, 360.0, both.shape[1], endpoint=False), 1e6 * both[k])
            for name, both in circles.items()
        ])
        for k, sense in enumerate(SENSES)
    ]  # fmt: skip
    return Chart(
        "Deviation of the radius over the angle of the simulated circular test, in both senses of rotation.", panels
    )
