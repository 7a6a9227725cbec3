"""The closed current loop: the force follows the request as a first- or a second-order system, integrated exactly.

First order, and where a damping D is stated second order, with w = 2 pi f:

    F' = w (u - F)                      F'' + 2 D w F' + w^2 F = w^2 u

Under a constant request both have a solution in closed form, and so has its integral, the momentum that it passes on.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.model.parameters import Actuator
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.exponential import exp_neg
from diffdrive.numerics.oscillator import Oscillator, discretise


class CurrentLoopState(NamedTuple):
    """Force (N), and of a second-order loop its rate (N/s)."""

    force: Scalar
    rate: Scalar | None


def settled(actuator: Actuator, force: Scalar) -> CurrentLoopState | None:
    """The state after a long time at a constant `force` (N); None where no current loop is stated."""
    if actuator.current_loop_frequency is None:
        return None
    return CurrentLoopState(force, None if actuator.current_loop_damping is None else 0.0 * force)


def ramp_lag(actuator: Actuator) -> Scalar:
    """How late (s) a ramp of requests is answered, once settled: 1 / w, or D 2 / w; none without a current loop."""
    if actuator.current_loop_frequency is None:
        return 0.0
    damping = 0.5 if actuator.current_loop_damping is None else actuator.current_loop_damping
    return damping / (jnp.pi * actuator.current_loop_frequency)


def advance(
    actuator: Actuator, state: CurrentLoopState, request: Scalar, time: Scalar
) -> tuple[CurrentLoopState, Scalar]:
    """The state after a `time` (s) at a constant `request` (N), and the integral of the force over it (N s)."""
    assert actuator.current_loop_frequency is not None
    angular = 2.0 * jnp.pi * actuator.current_loop_frequency
    if actuator.current_loop_damping is None:
        deviation, decay = state.force - request, exp_neg(angular * time)
        impulse = request * time + deviation * ((1.0 - decay) / angular)
        return CurrentLoopState(request + deviation * decay, None), impulse
    assert state.rate is not None
    push = request * angular**2
    ahead = discretise(angular, actuator.current_loop_damping, time).step(Oscillator(state.force, state.rate), push)
    # the equation itself, integrated
    fallen, slowed = state.force - ahead.deflection, state.rate - ahead.rate
    impulse = request * time + (slowed + 2.0 * actuator.current_loop_damping * angular * fallen) / angular**2
    return CurrentLoopState(ahead.deflection, ahead.rate), impulse


def mean_forces(actuator: Actuator, requests: Float[Array, " n"], period: Scalar) -> Float[Array, " n"]:
    """Mean force (N) in each `period` (s) of requests (N) that are held over it; before them was the first one.

    Where no current loop is stated, the requests themselves.
    """
    begin = settled(actuator, requests[0])
    if begin is None:
        return requests

    def body(state: CurrentLoopState, request: Scalar) -> tuple[CurrentLoopState, Array]:
        state, impulse = advance(actuator, state, request, period)
        return state, jnp.asarray(impulse / period)

    return lax.scan(body, begin, requests)[1]
