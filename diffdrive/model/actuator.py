"""Command to force: limit, then delay.

A delay of a fraction f of the period lets the last force act for the first f of it: the mean force over the period,
f F[k-1] + (1 - f) F[k], is what acts here throughout, so that the momentum is exact and the result smooth in f.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffdrive.model.parameters import Actuator
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.pipeline import Pipeline, filled, pushed


class ActuatorState(NamedTuple):
    """Forces in the delay line, next first, the last one that left it, and the one that acted over the last period."""

    pending: Pipeline
    arrived: Scalar
    applied: Scalar


def init(actuator: Actuator) -> ActuatorState:
    """No force, and none in the delay line."""
    zero = jnp.zeros(())
    return steady_state(actuator, zero)


def steady_state(actuator: Actuator, force: Scalar) -> ActuatorState:
    """The state after a long time at a constant `force` (N)."""
    return ActuatorState(filled(force, actuator.delay_samples), force, force)


def saturate(actuator: Actuator, command: Scalar) -> Scalar:
    """The command (N) within the force limit, whose corners `limit_rounding` rounds by softplus."""
    limit, width = actuator.force_limit, actuator.limit_rounding
    if limit is None:
        return command
    if width is None:
        return jnp.clip(command, -limit, limit)
    rise = jax.nn.softplus((command + limit) / width) - jax.nn.softplus((command - limit) / width)
    return width * rise - limit


def step(actuator: Actuator, state: ActuatorState, command: Scalar) -> ActuatorState:
    """The force for the coming period is `applied` of the state returned."""
    now, pending = pushed(state.pending, saturate(actuator, command))
    fraction = actuator.delay_fraction
    applied = now if fraction is None else fraction * state.arrived + (1.0 - fraction) * now
    return ActuatorState(pending, now, applied)
