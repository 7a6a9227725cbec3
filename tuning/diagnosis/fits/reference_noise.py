"""How far the filter that compares models trusts each of them, and whether it is lost with that.

A lost filter begins again from the measurement, time after time, and sees no force.
"""

import numpy as np
from jaxtyping import Float

from tuning.diagnosis.filter.ekf import EkfResult
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.levels import LOST

Forces = Float[np.ndarray, " 2"]  # N, as in `ProcessNoise`

TRUSTED = 0.02  # of the Coulomb friction: the force that the comparing filter takes every model to lack
MORE = (1.0, 10.0, 100.0, 1000.0)  # times that, where the filter is lost with less
SELDOM = 0.01  # of the samples, at which it may be lost


def lost_samples(fitted: Fitted) -> int:
    """At how many samples the filter was lost."""
    return _lost(fitted.filtered, np.asarray(fitted.model.logged.lanes.counts))


def _lost(filtered: EkfResult, counts: Float[np.ndarray, "lanes n"]) -> int:
    ratio = np.abs(np.asarray(filtered.normalised_innovation))
    return int(np.sum(~(ratio <= LOST) & (counts > 0.0)))  # one that ran away is


def share_lost(filtered: EkfResult, counts: Float[np.ndarray, "lanes n"]) -> float:
    """At what share of the samples that count the filter was lost."""
    return _lost(filtered, counts) / max(float(np.sum(counts)), 1.0)


def lost_share(fitter: Fitter, fitted: Fitted, process_noise: Forces) -> float:
    """At what share of the samples it is lost with these process forces (N)."""
    filtered = fitter.again(fitted, process_noise).filtered
    return share_lost(filtered, np.asarray(fitter.logged.lanes.counts))


def least_trusted(fitter: Fitter) -> Forces:
    """The process forces (N) of a filter that trusts every model to a small share of the friction."""
    logged = fitter.logged
    friction = setting(logged.drive, logged.lanes, logged.sampling.period).friction
    return np.maximum([TRUSTED * friction, fitter.least], fitter.floor)


def least_following(fitter: Fitter, fitted: Fitted) -> Forces | None:
    """The least process forces (N) with which the filter follows a model; None where none helps (blows).

    Sudden ones too behind a screw: a blow that is a little early or late is made up for at once.
    """
    lasting, sudden = least_trusted(fitter)
    tried = [np.array([more * lasting, own]) for more in MORE for own in (sudden, more * lasting)]
    tried = tried if fitted.model.screw else tried[::2]
    return next((one for one in tried if lost_share(fitter, fitted, one) <= SELDOM), None)


def reference_process_noise(fitter: Fitter, base: Fitted) -> Forces:
    """The process forces (N) of the filter that compares models: those with which it follows `base`, or the least."""
    found = least_following(fitter, base)
    return least_trusted(fitter) if found is None else found
