"""The friction that a drive would have shown along a measured motion."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.friction import bristle_at, friction_force, slide
from diffdrive.parameters import Drive, Scalar


def friction_along(
    drive: Drive, velocity: Float[Array, " n"], load: Float[Array, " n"], period: Scalar
) -> Float[Array, " n"]:
    """Friction and damping (N) at these velocities (m/s) and loads (N), the bristle relaxed at the start.

    Between two samples, `period` (s) apart, the bristle moves at their mean velocity.
    """

    def body(deflection: Scalar, at: tuple[Scalar, Scalar, Scalar]) -> tuple[Scalar, Scalar]:
        now, ahead, applied = at
        force = friction_force(bristle_at(drive.friction, now, deflection, applied), now, deflection)
        mean = 0.5 * (now + ahead)
        rate = bristle_at(drive.friction, mean, deflection, applied).rate
        return slide(deflection, mean, rate, period), force + drive.plant.damping.towards(now) * now

    ahead = jnp.concatenate([velocity[1:], velocity[-1:]])
    return lax.scan(body, jnp.zeros(()), (velocity, ahead, load))[1]
