"""The force of the motor in each row of a log: the actuator's own, and derivatives by the delay."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from diffdrive.model import actuator
from diffdrive.model.parameters import Actuator
from tuning.identification.row_force import delayed


@given(st.integers(0, 3), st.floats(0.0, 1.0))
@example(0, 0.0)
@example(2, 1.0)
def test_a_delayed_command_is_the_actuators(whole, fraction):
    command = np.r_[0.0, np.random.default_rng(0).normal(size=30)]
    machine = Actuator(delay_samples=whole, delay_fraction=fraction)
    state, forces = actuator.init(machine), []
    for one in command:
        state = actuator.step(machine, state, one, 1e-4)
        forces.append(float(state.applied))
    np.testing.assert_allclose(delayed(jnp.asarray(command), whole + fraction), forces, atol=1e-14)


@given(st.floats(-1.0, 4.0))
@example(-1.0)
@example(4.0)
def test_a_delay_is_linear_interpolation_and_a_negative_one_advances(delay):
    command = np.random.default_rng(1).normal(size=30)
    at = np.arange(30.0)
    np.testing.assert_allclose(delayed(jnp.asarray(command), delay), np.interp(at - delay, at, command), atol=1e-12)


@pytest.mark.parametrize("delay", [-0.7, 0.0, 1e-17, -1e-17, 1.0, 1.3, 2.0, 3.0])
def test_the_delay_of_a_ramp_has_the_ramps_slope_for_a_derivative(delay):
    """Also at whole delays, where searches start; and none at all for a constant command."""
    slope = jax.jacfwd(lambda d: delayed(5.0 + 2.0 * jnp.arange(20.0), d))(delay)
    np.testing.assert_allclose(slope[5:-2], -2.0, atol=1e-12)
    np.testing.assert_allclose(jax.jacfwd(lambda d: delayed(jnp.full(20, 5.0), d))(delay), 0.0, atol=1e-12)
