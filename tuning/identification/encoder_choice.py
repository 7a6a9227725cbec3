"""Whether both encoders of an axis can be fitted at once, or the scale alone.

Both together know more, if one rigid machine explains both; the scale alone knows less, but is right where the motor
moves against the table as that machine does not. So the two estimates must agree: Hausman's test (Specification tests
in econometrics, Econometrica 46, 1978), with the covariance of the scale's estimate for that of the difference, of
which it is the larger part. So the test is a little conservative.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import scipy.stats
from jaxtyping import Float

from tuning.identification.estimates import EstimateStatus, ParameterEstimate

SIGNIFICANCE = 0.01
DEPENDENT = 1e-9  # of the largest eigenvalue of a correlation matrix, below which a direction is another's


class Answer(Protocol):
    """What an identification says of its parameters."""

    @property
    def estimates(self) -> Sequence[ParameterEstimate]:
        """Each parameter."""

    @property
    def estimate_covariance(self) -> Float[np.ndarray, "q q"]:
        """Their covariance, in that order."""


def permitted(both: Answer, alone: Answer) -> float:
    """How often the scale alone would be so far from the answer of both, if both were right: a p-value.

    It is 1 where they have no fitted parameter in common. The delay is none: that of both is of the motor's readings,
    that of the scale alone of its own.
    """
    fitted = {
        one.path: one.value for one in both.estimates if one.status is EstimateStatus.FITTED and one.name != "delay"
    }
    common = [
        k
        for k, one in enumerate(alone.estimates)
        if one.status is EstimateStatus.FITTED and one.path in fitted and alone.estimate_covariance[k, k] > 0.0
    ]
    if not common:
        return 1.0
    apart = np.array([alone.estimates[k].value - fitted[alone.estimates[k].path] for k in common])
    covariance = alone.estimate_covariance[np.ix_(common, common)]
    deviation = np.sqrt(np.diag(covariance))
    values, directions = np.linalg.eigh(covariance / np.outer(deviation, deviation))
    kept = values > DEPENDENT * values[-1]
    distance = float(np.sum((directions.T @ (apart / deviation))[kept] ** 2 / values[kept]))
    return float(scipy.stats.chi2.sf(distance, np.count_nonzero(kept)))
