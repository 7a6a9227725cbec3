"""A small convex quadratic program by non-negative least squares (Lawson & Hanson 1974, least distance programming).

minimise  g d + d H d / 2   subject to   C d <= b
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
from jaxtyping import Float

DAMPING = 1e-9  # of the largest curvature
INCOMPATIBLE = 1e-9  # relative: what is left of the least distance where the constraints contradict each other


class QPSolution(NamedTuple):
    """The minimiser and the price of each constraint; None where no point keeps them all."""

    d: Float[np.ndarray, " k"]
    multipliers: Float[np.ndarray, " m"]


def quadratic_program(
    h: Float[np.ndarray, "k k"], g: Float[np.ndarray, " k"], c: Float[np.ndarray, "m k"], b: Float[np.ndarray, " m"]
) -> QPSolution | None:
    """Solve it; `h` is symmetric and not negative, and is damped where it is singular."""
    root = scipy.linalg.cholesky(h + DAMPING * max(float(np.max(np.diag(h))), 1e-300) * np.eye(len(g)))
    # with z = root d + root^-T g: minimise |z| / 2 subject to G z >= f
    free = scipy.linalg.solve_triangular(root, g, trans="T")
    turned = -scipy.linalg.solve_triangular(root, c.T, trans="T").T
    right = turned @ free - b
    unit = max(1.0, float(np.max(np.abs(right), initial=0.0)))
    stacked, wanted = np.vstack([turned.T, right / unit]), np.r_[np.zeros(len(g)), 1.0]
    prices, _ = scipy.optimize.nnls(stacked, wanted)
    residual = stacked @ prices - wanted
    if -residual[-1] <= INCOMPATIBLE:
        return None
    z = -unit * residual[:-1] / residual[-1]
    d = scipy.linalg.solve_triangular(root, z - free)
    return QPSolution(d, unit * prices / -residual[-1])
