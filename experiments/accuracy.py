"""How exact the plant's integrator is: error against the number of substeps, in a sampled loop through a reversal."""

from functools import partial
from typing import Any

import jax
import numpy as np

from diffdrive.controllers import PD
from diffdrive.controllers.base import Gains, Tracking
from diffdrive.motion import triangular
from diffdrive.parameters import Sampling, as_arrays
from diffdrive.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.simulate import inputs_of, rollout

SUBSTEPS = (1, 2, 3, 5, 8, 16)
REFERENCE = 1024
CASES = ((0.0002, 0.2), (0.010, 0.3), (0.200, 0.2))  # speed m/s, rounding of the reversal s


@partial(jax.jit, static_argnums=2)
def _positions(models: Any, inputs: Any, sampling: Sampling) -> Any:
    return rollout(*models, inputs, sampling).position


def integrator_errors() -> list[list[Any]]:
    """Rows of speed (mm/s) and, for each number of substeps, the largest position error over 1 s in nm."""
    models = as_arrays((paper_drive(quantised=False), PD(Tracking(Gains(PAPER_KP, PAPER_KD)))))
    rows = []
    for speed, rounding in CASES:
        motion = triangular(speed=speed, stroke=0.5 * speed, rounding=rounding, duration=1.0, rate=10_000.0)
        inputs = inputs_of(motion, np.zeros(len(motion.time)))
        truth = np.asarray(_positions(models, inputs, Sampling(substeps=REFERENCE)))
        found = [np.asarray(_positions(models, inputs, Sampling(substeps=n))) for n in SUBSTEPS]
        rows.append([1e3 * speed, *(1e9 * float(np.max(np.abs(one - truth))) for one in found)])
    return rows
