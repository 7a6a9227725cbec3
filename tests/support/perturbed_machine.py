"""Fits of logs of a machine that is not quite as its drive file says."""

import dataclasses
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.model.parameters import Sampling
from diffdrive.numerics.arrays import as_arrays
from tests.support.sound_log import DRIVE, RATE, simulate_log, two_sines
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.calibration import LOGARITHMS, TOLERANCE, calibrated
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Logged
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.search import recalibrated
from tuning.identification.problem import lanes_of, noise_floor

# how far the machine is from its file, but for constant force and delay
DEVIATIONS = np.append(np.random.default_rng(5).uniform(-0.02, 0.02, LOGARITHMS), [0.0, 0.0])


def fitter_of(*effects, seed=1):
    """A log of a machine that is not quite as its file says, with these effects; `seed` is that of its noise."""
    machine = jax.tree.map(float, calibrated(DRIVE.drive, jnp.asarray(DEVIATIONS)))
    truth = dataclasses.replace(DRIVE, drive=dataclasses.replace(machine, effects=effects))
    lanes = lanes_of([simulate_log(truth, two_sines(), seed)])
    noise = jnp.asarray(noise_floor(DRIVE.drive, lanes, RATE))
    return Fitter(Logged(as_arrays(DRIVE.drive), jnp.zeros(()), lanes, (0,), noise, Sampling(RATE, 10), jnp.zeros(1)))


@cache
def recalibrated_of(*effects):
    """`fitter_of` these effects and its recalibrated fit, which takes seconds: one for all who ask in a process."""
    fitter = fitter_of(*effects)
    return fitter, recalibrated(fitter, TOLERANCE)


def catalogue(fitter, base):
    """What may be missing beside a fit."""
    return candidates(setting(base.recalibrated_drive, fitter.logged.lanes, 1.0 / RATE))
