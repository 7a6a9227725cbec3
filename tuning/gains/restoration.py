"""An unstable start, moved to where the loop is stable: by the linearised loop alone, as simulations may diverge."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tuning.gains.constrained import DesignPoint, LinearisedPoint
from tuning.optimisation.least_distance import quadratic_program

OVERSHOOT = 1.3  # of what is missed: a growth rate is no straight line
RELAXATIONS = (1.0, 0.5, 0.25, 0.1)  # share of what is missed that one step is to restore


def is_simulable(point: DesignPoint) -> bool:
    """Whether the loop is stable and its simulation stays finite, so that an objective means something."""
    return bool(np.isfinite(float(point.objective)) and float(jnp.max(point.constraints["stability"])) <= 0.0)


def stabilising_step(linearised: LinearisedPoint, radius: float) -> Float[np.ndarray, " k"] | None:
    """The shortest step within the radius that takes every growth rate below zero, or as far as one step can.

    None where the loop is as stable as it gets: its growth rates have no slope, or the linearised loop is stable and
    it is the simulation that diverges.
    """
    values, slopes = (
        np.asarray(linearised.point.constraints["stability"]),
        np.asarray(linearised.constraint_jacobians["stability"]),
    )
    known = np.isfinite(values) & np.isfinite(slopes).all(axis=1) & (slopes != 0.0).any(axis=1)
    values, slopes, count = values[known], slopes[known], slopes.shape[1]
    if not (values > 0.0).any():
        return None
    box = np.vstack([np.eye(count), -np.eye(count)])
    for share in RELAXATIONS:
        room = np.where(values > 0.0, -OVERSHOOT * share * values, -values)
        rows, ends = np.vstack([slopes, box]), np.r_[room, np.full(2 * count, radius)]
        solved = quadratic_program(np.eye(count), np.zeros(count), rows, ends)
        if solved is not None:
            return np.clip(solved.d, -radius, radius)
    # one at a time: the growth rate that is worst
    worst = slopes[np.argmax(values)]
    return -radius * worst / np.max(np.abs(worst))
