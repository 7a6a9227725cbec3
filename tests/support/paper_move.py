"""The paper's drive without its quantiser, and a motion there and back for it."""

import numpy as np

from diffdrive import motion as motions
from diffdrive.controllers.base import paper_tracking
from diffdrive.loop.run import Run
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive

RATE = 10_000.0
IDEAL = paper_drive(quantised=False)
TRACKING = paper_tracking(IDEAL, PAPER_KP, PAPER_KD)
OFF_GRID = 12.34564e-6  # the first measured error is 40 nm on the scale of 0.1 um
MOVE = motions.jerk_limited(
    distance=2e-3, speed=0.01, acceleration=1.0, jerk=100.0, rate=RATE, dwell=0.02, start=OFF_GRID
)
SETTLED = np.flatnonzero(np.isclose(MOVE.velocity, 0.01, rtol=1e-9))[-1]  # at the end of the first stroke's cruise


def run_of(controller, drive=IDEAL, **options) -> Run:
    return simulate_loop(drive, controller, MOVE, **options).require_ok()
