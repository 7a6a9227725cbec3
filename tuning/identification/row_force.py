"""The force of the motor in each row of a log, from the logged command."""

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.model.actuator import saturate
from diffdrive.model.current_loop import mean_forces
from diffdrive.model.parameters import Actuator
from diffdrive.numerics.arrays import Scalar

MAX_DELAY = 8  # control periods
MIN_DELAY = -1  # a command that is logged one sample late


def delayed(command: Float[Array, " n"], delay: Scalar) -> Float[Array, " n"]:
    """The command `delay` periods later, linear between samples; before the log its first value."""
    shifted = jnp.zeros_like(command)
    # not 1 - |delay - periods|: at whole delays, where searches start, its derivative is none of this one's
    samples = lax.stop_gradient(jnp.clip(jnp.floor(delay), MIN_DELAY, MAX_DELAY - 1))
    fraction = delay - samples
    for periods in range(MIN_DELAY, MAX_DELAY + 1):
        share = jnp.where(periods == samples, 1.0 - fraction, jnp.where(periods == samples + 1, fraction, 0.0))
        if periods >= 0:
            past = jnp.concatenate([jnp.full(periods, command[0]), command[: len(command) - periods]])
        else:
            past = jnp.concatenate([command[-periods:], jnp.full(-periods, command[-1])])
        shifted = shifted + share * past
    return shifted


def applied_force(actuator: Actuator, command: Float[Array, " n"], delay: Scalar, period: float) -> Float[Array, " n"]:
    """The force (N) of the motor in each row.

    The command is limited, answered by the current loop where one is stated, and delayed.
    """
    requested = jnp.asarray(saturate(actuator, command))
    return delayed(mean_forces(actuator, requested, period), delay)
