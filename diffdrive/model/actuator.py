"""Command to force: limit, then delay, then the current loop.

A delay of a fraction f of the period lets the last force act for the first f of it: the mean force over the period,
f F[k-1] + (1 - f) F[k], is what acts here throughout, so that the momentum is exact and the result smooth in f. A
current loop that is stated answers both parts of the period, and what acts is the mean of its force.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffdrive.model import current_loop
from diffdrive.model.parameters import Actuator
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.pipeline import Pipeline, filled, pushed


class ActuatorState(NamedTuple):
    """Forces in the delay line, next first, the last one that left it, and the one that acted over the last period.

    Where a current loop is stated, its state at the end of that period.
    """

    pending: Pipeline
    arrived: Scalar
    applied: Scalar
    current: current_loop.CurrentLoopState | None = None


def init(actuator: Actuator) -> ActuatorState:
    """No force, and none in the delay line."""
    zero = jnp.zeros(())
    return steady_state(actuator, zero)


def steady_state(actuator: Actuator, force: Scalar) -> ActuatorState:
    """The state after a long time at a constant `force` (N)."""
    current = current_loop.settled(actuator, force)
    return ActuatorState(filled(force, actuator.delay_samples), force, force, current)


def saturate(actuator: Actuator, command: Scalar) -> Scalar:
    """The command (N) within the force limit, whose corners `limit_rounding` rounds."""
    if actuator.force_limit is None:
        return command
    return limited(command, actuator.force_limit, actuator.limit_rounding)


def limited(force: Scalar, limit: Scalar, rounding: Scalar | None) -> Scalar:
    """The force (N) within the limit, whose corners are rounded over a width by softplus; None: sharp."""
    if rounding is None:
        return jnp.clip(force, -limit, limit)
    rise = jax.nn.softplus((force + limit) / rounding) - jax.nn.softplus((force - limit) / rounding)
    return rounding * rise - limit


def step(actuator: Actuator, state: ActuatorState, command: Scalar, period: float) -> ActuatorState:
    """The force for the coming `period` (s) is `applied` of the state returned."""
    now, pending = pushed(state.pending, saturate(actuator, command))
    fraction = actuator.delay_fraction
    if state.current is None:
        applied = now if fraction is None else fraction * state.arrived + (1.0 - fraction) * now
        return ActuatorState(pending, now, applied)
    current, impulse = state.current, 0.0 * now
    requests = [(now, 1.0)] if fraction is None else [(state.arrived, fraction), (now, 1.0 - fraction)]
    for request, share in requests:
        current, passed = current_loop.advance(actuator, current, request, share * period)
        impulse = impulse + passed
    return ActuatorState(pending, now, impulse / period, current)
