"""Command to force: limit, then whole samples of delay."""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffdrive.parameters import Actuator, Scalar


class ActuatorState(NamedTuple):
    """Forces still under way, next first, and the one that acted over the last period."""

    pending: tuple[Scalar, ...]
    applied: Scalar


def init(actuator: Actuator) -> ActuatorState:
    """No force now, none under way."""
    zero = jnp.zeros(())
    return ActuatorState((zero,) * actuator.delay_samples, zero)


def limited(actuator: Actuator, command: Scalar) -> Scalar:
    """The command within the force limit; with `limit_rounding`, the limit's corners are rounded by softplus."""
    limit, width = actuator.force_limit, actuator.limit_rounding
    if limit is None:
        return command
    if width is None:
        return jnp.clip(command, -limit, limit)
    rise = jax.nn.softplus((command + limit) / width) - jax.nn.softplus((command - limit) / width)
    return width * rise - limit


def step(actuator: Actuator, state: ActuatorState, command: Scalar) -> ActuatorState:
    """The force for the coming period is `applied` of the state returned."""
    *ready, newest = (*state.pending, limited(actuator, command))
    if not ready:
        return ActuatorState((), newest)
    return ActuatorState((*ready[1:], newest), ready[0])
