"""The normal equations of what is added to a fit, when what is free already has made way for it.

With residuals r, their Jacobian J by what is free, its curvature H = J'J + 1 and values theta (in units of the prior),
columns D that are added by amounts a change the cost by a'S a + 2 g'a, where

    S = D'D - D'J H^-1 J'D ,   g = D'r - D'J H^-1 (J'r + theta) .
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tuning.diagnosis.fits.curvature import solved
from tuning.diagnosis.fits.fitted import Fitted


class Reduced(NamedTuple):
    """Curvature S and slope g, and how what is free moves: by minus `wanted` alone, by minus `way` for each column."""

    curvature: Float[np.ndarray, "m m"]
    slope: Float[np.ndarray, " m"]
    wanted: Float[np.ndarray, " k"]
    way: Float[np.ndarray, "k m"]


def reduced(fitted: Fitted, columns: Float[np.ndarray, "n m"]) -> Reduced:
    """Of the derivatives of the residuals by what is added."""
    wanted = solved(fitted.hessian, fitted.jacobian.T @ fitted.residual + fitted.theta)
    cross = fitted.jacobian.T @ columns
    way = solved(fitted.hessian, cross)
    curvature = columns.T @ columns - cross.T @ way
    return Reduced(curvature, columns.T @ fitted.residual - cross.T @ wanted, wanted, way)
