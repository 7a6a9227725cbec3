"""How long a step of integration the logs allow.

A step that is too long makes an error where the table stops and starts, which a long log of a fine scale tells as well
as any effect, and which any effect that moves that error a little seems to explain. So the step is halved as long as
the likelihood of the recalibrated drive depends on it by as much as an effect would have to bring.
"""

import dataclasses

import numpy as np

from diffdrive.model.parameters import LONGEST_SUBSTEP
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import missing
from tuning.diagnosis.levels import DETAILS, WORTH


def with_step_short_enough(fitter: Fitter, base: Fitted) -> tuple[Fitter, Fitted]:
    """The logs in steps on which the likelihood no longer depends, and the recalibrated drive fitted to those.

    No step is shorter than half the simulator's own longest, whose error is less than any scale tells.
    """
    while fitter.logged.sampling.period / fitter.logged.sampling.plant_steps > LONGEST_SUBSTEP:
        finer = _with_half_the_step(fitter)
        model = base.model.on(finer.logged)
        there = finer.settled(model, base.theta, base.process_noise, base.filtered.trajectory)
        lacking = missing(fitter, base)
        if not np.isfinite(lacking) or abs(there.cost - base.cost) < max(WORTH, DETAILS * lacking):
            break
        fitter, base = finer, finer.refit(base, model)
    return fitter, base


def _with_half_the_step(fitter: Fitter) -> Fitter:
    sampling = fitter.logged.sampling
    finer = dataclasses.replace(sampling, substeps=2 * sampling.plant_steps)
    return Fitter(fitter.logged._replace(sampling=finer), fitter.twist, fitter.store)
