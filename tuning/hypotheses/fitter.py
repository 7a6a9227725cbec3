"""A fitter that takes motor and table for one mass wherever that tells a derivative.

A screw swings at its resonance. What is slower moves motor and table alike, so that the nominal parameters and the
effects that act on either need no filter of their own for each derivative: only the screw's own numbers do. Steps are
taken where the cost itself falls, so the least is the same; the curvature there is this approximation's.
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float

from tuning.diagnosis.filter.derivatives import StepJacobians
from tuning.diagnosis.fits.differences import by_numbers
from tuning.diagnosis.fits.fitted import Point
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.model import Model, Vector


class OneMassFitter(Fitter):
    """Fits hypotheses about the same logs; derivatives beside a screw are those of one mass."""

    def jacobian(
        self, model: Model, point: Point, linear: StepJacobians | None = None, free: Vector | bool = True
    ) -> Float[np.ndarray, "m k"]:
        if not (model.coupled and model.screw):
            return super().jacobian(model, point, linear, free)
        within = stepped_within(model)
        loose = dataclasses.replace(model, members=tuple(one for one in model.members if not one.candidate.coupled))
        there = point._replace(theta=point.theta[~within])
        wanted = within & np.broadcast_to(np.asarray(free, bool), model.size)
        found = by_numbers(
            model, point.theta, point.process_noise, point.filtered, point.trajectory, np.flatnonzero(wanted)
        )
        found = self.residuals(point)[1][:, None] * found
        found[:, ~within] = super().jacobian(loose, there, linear)
        return found


def stepped_within(model: Model) -> Bool[np.ndarray, " k"]:
    """Which numbers of u are of effects that are stepped within the filter."""
    coupled = [member.candidate.coupled for member in model.members]
    return np.r_[np.zeros(len(NAMES), bool), np.array([coupled[index] for index, _, _ in model.slots], bool)]
