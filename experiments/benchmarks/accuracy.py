"""How exact the plant's integrator is: error against the number of substeps, in a sampled loop through a reversal."""

import dataclasses
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import PD
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Drive, Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion.builders import triangular
from diffdrive.numerics.arrays import Scalar, as_arrays
from experiments.studies.recovery.random_drive import random_drive

SUBSTEPS = (1, 2, 3, 5, 8, 16)
REFERENCE_SUBSTEPS = 1024
DRIVES, CONVERGED_FACTOR = 64, 16  # random ones, and substeps in each of the default's
RATES = (10_000.0, 1_000.0)
CASES = ((0.0002, 0.2), (0.010, 0.3), (0.200, 0.2))  # speed m/s, rounding of the reversal s


@partial(jax.jit, static_argnums=2)
def _positions(models: tuple[Drive, PD], inputs: Inputs, sampling: Sampling) -> Float[Array, " n"] | Scalar:
    drive, controller = models
    return rollout_loop(drive, controller, inputs, sampling).table_position


def integrator_errors() -> list[list[float]]:
    """Rows of speed (mm/s) and, for each number of substeps, the largest position error over 1 s in nm."""
    models = as_arrays((paper_drive(quantised=False), PD(Tracking(PDGains(PAPER_KP, PAPER_KD)))))
    rows = []
    for speed, rounding in CASES:
        inputs = _motion_inputs(speed, rounding, 10_000.0)
        reference = np.asarray(_positions(models, inputs, Sampling(substeps=REFERENCE_SUBSTEPS)))
        positions = [np.asarray(_positions(models, inputs, Sampling(substeps=n))) for n in SUBSTEPS]
        rows.append([1e3 * speed, *(1e9 * float(np.max(np.abs(position - reference))) for position in positions)])
    return rows


def _motion_inputs(speed: float, rounding: float, rate: float) -> Inputs:
    motion = triangular(speed=speed, stroke=speed * (0.5 - rounding / 2), rounding=rounding, duration=1.0, rate=rate)
    return loop_inputs(motion, np.zeros(len(motion.time)))


def errors_of_random_drives() -> list[list[float]]:
    """Rows of rate (Hz), speed (mm/s) and, over random drives with the default substeps, the median, the 95 % quantile
    and the largest of the largest position error over 1 s, in nm; and how many drives.

    Each parameter is off the paper's by up to `random_drive.SPREAD`.
    """
    rng = np.random.default_rng(0)
    drives = [dataclasses.replace(random_drive(rng), sensor=Sensor()) for _ in range(DRIVES)]
    machines = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(as_arrays(drive) for drive in drives))
    control = as_arrays(PD(Tracking(PDGains(PAPER_KP, PAPER_KD))))

    @partial(jax.jit, static_argnums=1)
    def positions(inputs: Inputs, sampling: Sampling) -> Float[Array, "drives n"] | Scalar:
        return jax.vmap(lambda machine: rollout_loop(machine, control, inputs, sampling).table_position)(machines)

    rows = []
    for rate in RATES:
        default = Sampling(rate)
        fine = Sampling(rate, CONVERGED_FACTOR * default.plant_steps)
        for speed, rounding in CASES:
            inputs = _motion_inputs(speed, rounding, rate)
            position, reference = (np.asarray(positions(inputs, sampling)) for sampling in (default, fine))
            error = 1e9 * np.abs(position - reference).max(axis=1)
            rows.append([rate, 1e3 * speed, *np.quantile(error, (0.5, 0.95, 1.0)), len(error)])
    return rows
