"""Whether the model suffices: white innovations, and no force missing.

A filter with a process force whitens its innovations even where the model is wrong, so both are looked at: how much of
the innovations is predictable from earlier ones, and how large a force the filter had to invent.
"""

from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from tuning.identification.uncertainty import autocorrelation

LAGS = 100
PREDICTABLE = 0.01  # share of the variance
IMPROBABLE = 1e-3  # p-value
MISSING_SHARE = 2e-3  # of the Coulomb friction
DEVIANCE = 20.0  # a gain beyond any chance


class Adequacy(NamedTuple):
    """What is left when the model has explained what it can."""

    p_value: float  # Ljung-Box: how often white noise would look like these innovations
    predictable: float  # share of the innovations' variance that an autoregression predicts from their past
    missing: float  # N, RMS of the force that the filter had to invent
    share: float  # of the Coulomb friction
    gain: float  # in deviance, by letting the filter invent it

    @property
    def has_structure(self) -> bool:
        """Structure beyond doubt and large enough to matter."""
        return self.is_coloured or self.lacks_force

    @property
    def is_coloured(self) -> bool:
        """Innovations that are predictable from earlier ones."""
        return not self.p_value >= IMPROBABLE and self.predictable > PREDICTABLE

    @property
    def lacks_force(self) -> bool:
        """A force that the filter had to invent; also where nothing could be judged."""
        return not self.gain <= DEVIANCE and not self.share <= MISSING_SHARE

    @property
    def says(self) -> str:
        """In plain words."""
        if np.isnan(self.missing):
            return "the logs are too short, or too torn, to say whether a force is missing"
        force = f"{self.missing:.2g} N RMS ({100 * self.share:.2g} % of the Coulomb friction)"
        predictable = (
            f"{100 * self.predictable:.2g} % of the innovations' variance is predictable from earlier innovations "
            f"({_chance(self.p_value)})"
        )
        if self.is_coloured and not self.lacks_force:
            return (
                f"the model does not explain all of the logs, though no force is missing ({force}): {predictable}; the "
                "measuring noise is coloured, as after a filter or between the resolution steps of a coarse scale"
            )
        if self.lacks_force:
            return (
                f"the model does not explain the logs: a force of {force} is missing, and {predictable}; the "
                "parameters are the best compromise of an incomplete model, and so are their intervals"
            )
        white = "white" if self.p_value >= IMPROBABLE else "as good as white"  # many samples show the least colour
        return (
            f"nothing is missing that these logs would show: the force left over is {force}, the innovations are "
            f"{white} (p = {self.p_value:.2g}, {100 * self.predictable:.2g} % of their variance predictable)"
        )


def _chance(p_value: float) -> str:
    return f"p < {IMPROBABLE:g}" if p_value < IMPROBABLE else f"p = {p_value:.2g}"


def adequacy(
    innovation: Float[np.ndarray, "lanes n"], gain: float, missing: Float[np.ndarray, "lanes n"], friction: float
) -> Adequacy:
    """Judge normalised innovations (zeros, the padding, do not count) and the missing force (N) over `friction` (N).

    Where the missing force is NaN it was not looked at.
    """
    counted = int(np.count_nonzero(innovation))
    lags = min(LAGS, innovation.shape[1] // 10)
    rho = autocorrelation(innovation, lags)
    statistic = counted * (counted + 2) * float(np.sum(rho**2 / (counted - np.arange(1, lags + 1))))
    table = np.r_[1.0, rho]
    toeplitz = table[np.abs(np.subtract.outer(np.arange(lags), np.arange(lags)))]
    weights = np.linalg.solve(toeplitz + 1e-9 * np.eye(lags), rho)
    predictable = (
        float(weights @ rho) - lags / counted
    )  # what fitting so many weights to white noise would seem to predict
    judged = np.isfinite(missing) & (innovation != 0.0)
    force = float(np.sqrt(np.mean(missing[judged] ** 2))) if judged.any() else float("nan")
    return Adequacy(float(scipy.stats.chi2.sf(statistic, lags)), max(0.0, predictable), force, force / friction, gain)
