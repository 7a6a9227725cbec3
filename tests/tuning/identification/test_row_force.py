"""The force of the motor in each row of a log: the actuator's own, what moves a mass, and derivatives by the delay."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import diffdrive as dd
from diffdrive.model import actuator, current_loop, plant
from diffdrive.model.friction import resolvable
from diffdrive.model.parameters import Actuator, Plant, Sampling
from diffdrive.model.quantity import Directional
from tuning.identification.row_force import (
    MAX_DELAY,
    BetweenRows,
    RowForce,
    advance,
    applied_force,
    delayed,
    loop_samples,
    smooth,
)

ROWS = np.arange(60.0)
INSIDE = slice(MAX_DELAY + 4, -6)  # rows whose polynomial goes through none that was repeated


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


# --- snapshots: the command goes on changing between rows


def cubic(time):
    return 3.0 - 0.2 * time + 0.05 * time**2 - 1e-3 * time**3


DELAYS = st.floats(-1.0, float(MAX_DELAY))


@given(DELAYS)
@example(0.0)
@example(-0.5)
@example(float(MAX_DELAY))
def test_a_cubic_command_is_read_exactly_at_any_delay(delay):
    force = smooth(jnp.asarray(cubic(ROWS)), delay)
    middle = ROWS - delay
    mean = 3.0 - 0.2 * middle + 0.05 * (middle**2 + 1 / 12) - 1e-3 * (middle**3 + middle / 4)
    change = np.stack([-0.2 + 0.1 * middle - 3e-3 * middle**2, 0.05 - 3e-3 * middle, np.full(60, -1e-3)], axis=1)
    np.testing.assert_allclose(force.mean[INSIDE], mean[INSIDE], atol=1e-9)
    np.testing.assert_allclose(force.change[INSIDE], change[INSIDE], atol=1e-9)


@pytest.mark.parametrize("delay", [-1.0, -0.5, 0.0, 0.3, 1.0, 4.5, 7.9])
def test_the_derivative_by_the_delay_is_that_of_the_command(delay):
    """Also where the four rows become the next four, at whole delays."""
    slope = jax.jacfwd(lambda d: smooth(jnp.asarray(cubic(ROWS)), d).mean)(delay)
    middle = ROWS - delay
    expected = 0.2 - 0.1 * middle + 3e-3 * (middle**2 + 1 / 12)
    np.testing.assert_allclose(slope[INSIDE], expected[INSIDE], atol=1e-9)


@given(DELAYS)
def test_before_and_behind_the_log_the_command_is_its_end_values(delay):
    force = smooth(jnp.full(30, 7.0), delay)
    np.testing.assert_allclose(force.mean, 7.0, atol=1e-12)
    np.testing.assert_allclose(force.change, 0.0, atol=1e-12)


def mass_moved(force_of, frequency, period):
    """The amplitude of a free mass under the force of a sine, over the exact one."""
    count = round(2.0 / (frequency * period))
    time = period * np.arange(count)
    command = jnp.asarray(np.sin(2 * np.pi * frequency * time))
    drive = dd.paper_axis(quantised=False).drive
    none = Directional(0.0, 0.0)
    friction = dataclasses.replace(
        drive.friction, coulomb_screw=none, load_coefficient=none, breakaway_gap=none, viscous=none
    )
    drive = resolvable(dataclasses.replace(drive, friction=friction, plant=Plant(1.0, 0.0)))
    sampling = Sampling(1.0 / period, 64)
    force, omega = force_of(command), 2 * np.pi * frequency

    def step(state, one):
        return advance(drive, state, one, jnp.asarray(0.0), sampling), state.position

    begin = plant.PlantState(jnp.asarray(0.0), jnp.asarray(-1.0 / omega), jnp.asarray(0.0))
    position = np.asarray(jax.lax.scan(step, begin, force)[1])
    basis = np.stack([np.sin(omega * time), np.cos(omega * time), np.ones(count), time], axis=1)
    return -float(np.linalg.lstsq(basis, position)[0][0]) * omega**2


def test_a_mass_seems_lighter_where_snapshots_are_read_as_held():
    """By (w T)^2 / 6 of its motion; read as smooth it moves as it should, but for the fourth power of w T."""
    frequency, period = 20.0, 2e-3
    lost = (2 * np.pi * frequency * period) ** 2 / 6.0
    held = mass_moved(lambda command: RowForce(delayed(command, -0.5)), frequency, period)
    assert 1.0 - held == pytest.approx(lost, rel=0.05)
    assert mass_moved(lambda command: smooth(command, -0.5), frequency, period) == pytest.approx(1.0, abs=0.02 * lost)


@pytest.mark.parametrize("damping", [None, 0.7])
def test_a_ramp_of_requests_lags_as_it_is_said(damping):
    machine = Actuator(current_loop_frequency=150.0, current_loop_damping=damping)
    rate, steps = 1e5, 4000

    def step(state, request):
        return current_loop.advance(machine, state, request, 1.0 / rate)[0], None

    ramp = (jnp.arange(steps) + 0.5) / rate
    force = jax.lax.scan(step, current_loop.settled(machine, jnp.asarray(0.0)), ramp)[0].force
    assert steps / rate - float(force) == pytest.approx(float(current_loop.ramp_lag(machine)), rel=1e-4)
    assert current_loop.ramp_lag(Actuator()) == 0.0


def test_a_smooth_command_is_limited_and_lags_in_the_current_loop():
    machine = Actuator(force_limit=30.0, current_loop_frequency=400.0)
    ramp, period = jnp.asarray(ROWS), 1e-3
    force = applied_force(machine, ramp, 0.25, period, BetweenRows.SMOOTH)
    late = 0.25 + 1.0 / (2 * np.pi * 400.0 * period)
    np.testing.assert_allclose(force.mean[12:25], ROWS[12:25] - late, atol=1e-9)
    np.testing.assert_allclose(force.mean[-8:], 30.0, atol=1e-9)


def test_a_lag_that_is_longer_than_any_delay_reads_the_rows_that_far_back():
    force = smooth(jnp.asarray(ROWS), 20.3)
    np.testing.assert_allclose(force.mean[25:-5], ROWS[25:-5] - 20.3, atol=1e-9)


@pytest.mark.parametrize("samples", range(1, 17))
def test_the_samples_of_a_loop_are_told_by_how_late_it_acts_in_its_row(samples):
    assert loop_samples(0.5 / samples - 0.5) == samples


@pytest.mark.parametrize(("delay", "samples"), [(-0.6, 16), (-0.5, 16), (0.0, 1), (0.4, 1), (2.0, 1)])
def test_what_acts_before_its_row_is_the_fastest_loop_and_what_acts_late_is_no_faster_one(delay, samples):
    assert loop_samples(delay) == samples
