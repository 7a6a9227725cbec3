"""Frequency responses of open loops: gain and phase, of a model, of what was measured, before and after tuning."""

from collections.abc import Mapping

import numpy as np

from diffdrive.loop.linearise import OperatingPoint, Response
from diffdrive.measured_loop import FrequencyComparison
from experiments.reports.page.chart import Chart, Line, Panel

FREQUENCY, GAIN, PHASE = "frequency, Hz", "|L|, dB", "phase of L, deg"


def bode_chart(panels: Mapping[str, Mapping[OperatingPoint, Response]]) -> Chart:
    """Gain and phase of the open loop at each operating point, a pair of panels for each controller."""
    drawn = []
    for title, labelled in panels.items():
        loops = [(_point(at), np.asarray(one.frequency), np.asarray(one.loop)) for at, one in labelled.items()]
        gain = [Line(name, frequency, _decibels(loop)) for name, frequency, loop in loops]
        phase = [Line(name, frequency, _degrees(loop)) for name, frequency, loop in loops]
        drawn.append(Panel(FREQUENCY, f"{GAIN}, {title}", gain, log_x=True))
        drawn.append(Panel(FREQUENCY, f"{PHASE}, {title}", phase, log_x=True))
    return Chart(f"Open loop L over frequency, gains {' and '.join(panels)}, at each speed and load.", drawn)


def measured_chart(found: FrequencyComparison) -> Chart:
    """The loop with what was measured beside the model's, and how far they part."""
    frequency = found.frequency
    loops = (("model", found.model_loop), ("measured", found.loop))
    panels = [
        Panel(FREQUENCY, GAIN, [Line(name, frequency, _decibels(loop)) for name, loop in loops], log_x=True),
        Panel(FREQUENCY, PHASE, [Line(name, frequency, _degrees(loop)) for name, loop in loops], log_x=True),
        Panel(
            FREQUENCY, "difference over distance to -1", [Line("difference", frequency, found.departure)],
            log_x=True, log_y=True,
        ),
    ]  # fmt: skip
    return Chart("Open loop L over frequency, measured and of the model, and by how much they part.", panels)


def _point(at: OperatingPoint) -> str:
    motion = "standstill" if at.velocity == 0 else f"{1e3 * float(at.velocity):g} mm/s"
    return f"{motion}, {1e-3 * float(at.load):g} kN"


def _decibels(loop: np.ndarray) -> np.ndarray:
    return 20.0 * np.log10(np.abs(loop))


def _degrees(loop: np.ndarray) -> np.ndarray:
    """Between -270 and 90, so that the line does not jump where it passes -180 or 0."""
    degrees = np.degrees(np.angle(loop))
    return np.where(degrees > 90.0, degrees - 360.0, degrees)
