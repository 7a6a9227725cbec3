"""The friction that a drive would have shown along a measured motion."""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.effects.base import Acts
from diffdrive.effects.stages import with_friction_offset
from diffdrive.model.friction import deflection_after, friction_force, lugre_coefficients
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar


class FrictionAlong(NamedTuple):
    """What resists a motion, sample by sample."""

    friction: Float[Array, " n"]  # N, and damping
    bristle: Float[Array, " n"]  # m, its deflection


def friction_along(
    drive: Drive,
    velocity: Float[Array, " n"],
    load: Float[Array, " n"],
    period: Scalar,
    acts: Acts | None = None,
) -> FrictionAlong:
    """Friction and its bristle at these velocities (m/s) and loads (N), the bristle relaxed at the start.

    Between two samples, `period` (s) apart, the bristle moves at their mean velocity. `acts`, [n] each, bend the
    friction.
    """

    def body(deflection: Array, sample: tuple[Array, Array, Array, Acts]) -> tuple[Array, FrictionAlong]:
        now, ahead, applied, acts = sample
        friction = with_friction_offset(drive, acts).friction
        force = friction_force(lugre_coefficients(friction, now, deflection, applied), now, deflection)
        mean = 0.5 * (now + ahead)
        rate = lugre_coefficients(friction, mean, deflection, applied).rate
        resisting = force + drive.plant.damping.towards(now) * now
        following = jnp.asarray(deflection_after(deflection, mean, rate, period))
        return following, FrictionAlong(jnp.asarray(resisting), deflection)

    ahead = jnp.concatenate([velocity[1:], velocity[-1:]])
    nothing = Acts(*(jnp.zeros_like(velocity) for _ in Acts._fields))
    return lax.scan(body, jnp.zeros(()), (velocity, ahead, load, acts or nothing))[1]
