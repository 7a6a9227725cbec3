"""What is believed of the two directions: friction that is the same in both, and no constant force beside it.

A constant force of c newtons is c newtons more of friction forwards and c less backwards: while the table moves, the
two cannot be told apart. Only at rest and at reversals they differ, by less than what a model leaves out. Without a
belief an axis that lies flat becomes a vertical one, with a hundred newtons of friction upwards and three thousand
downwards.
"""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float

from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import Scalar
from tuning.identification.unknowns import Unknowns

# Standard deviation of the logarithm of a parameter's ratio between the directions, beyond that of the drive file: the
# root mean square of those of the paper's axis (Table 2: friction levels 0.02, their ratio 0.08, Stribeck velocities
# 0.34, viscous friction 0.13) is 0.19. A constant force is believed to be as small a share of the Coulomb friction:
# that of EMPS, a horizontal axis, is 0.16 of it.
DIRECTIONS_STD = 0.2


def departure_from_symmetry(unknowns: Unknowns, believed: Unknowns) -> Float[Array, " m"]:
    """In standard deviations: how the directions differ more than believed, and the constant force beyond the believed.

    An axis that hangs states its constant force in the drive file; one that is not stated is found where the logs tell
    it from friction.
    """
    rows: list[Scalar] = []
    for field in dataclasses.fields(unknowns):
        pair, expected = getattr(unknowns, field.name), getattr(believed, field.name)
        if isinstance(pair, Directional) and isinstance(expected, Directional):
            rows.append((_log_ratio(pair) - _log_ratio(expected)) / DIRECTIONS_STD)
    level = 0.5 * (unknowns.coulomb.positive + unknowns.coulomb.negative)
    rows.append((unknowns.constant_force - believed.constant_force) / (DIRECTIONS_STD * level))
    return jnp.stack([jnp.asarray(row, dtype=jnp.float64) for row in rows])


def _log_ratio(pair: Directional) -> Scalar:
    """Of the directions; 0 where one of them has none of it, of which no ratio is believed: alike."""
    has_both = (pair.positive > 0.0) & (pair.negative > 0.0)
    return jnp.log(jnp.where(has_both, pair.positive, 1.0) / jnp.where(has_both, pair.negative, 1.0))
