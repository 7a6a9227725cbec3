"""The cascade with what real loops have, against a loop in NumPy, sample by sample."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import lfilter

from diffdrive import motion as motions
from diffdrive.controllers import Cascade, Feedforward, Reference
from diffdrive.loop.simulate import simulate_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Sampling
from diffdrive.numerics.arrays import as_arrays
from tests.diffdrive.controllers.test_filters import by_python_control
from tests.support.cascades import IDEAL, MOVE, ONE_EACH, PERIOD, RATE, ROUGH, WHOLE


def commands_in_numpy(c: Cascade, reference, velocity, acceleration, position):
    """The command of each sample; filters by difference equations with the coefficients of python-control."""
    a = PERIOD / (2.0 * (c.velocity_filter_time or 1.0))
    b = PERIOD / (2.0 * (c.reference_filter_time or 1.0))
    lagged = last_velocity = 0.0
    aimed = last_aim = reference[0]
    integral, held, forces = 0.0, 0.0, []
    for k in range(len(reference)):
        speed = (position[k] - position[max(k - c.velocity_samples, 0)]) * RATE / c.velocity_samples
        if c.velocity_filter_time:  # (1 + 1/2a') y = ...: the bilinear transform of T y' + y = u
            lagged = ((1.0 - a) * lagged + a * (speed + last_velocity)) / (1.0 + a)
            last_velocity, speed = speed, lagged
        aim = reference[max(k - c.reference_delay_samples, 0)]
        if c.reference_filter_time:
            aimed = ((1.0 - b) * aimed + b * (aim + last_aim)) / (1.0 + b)
            last_aim, aim = aim, aimed
        if k % c.position_every == 0:
            held = c.kp * (aim - position[k]) + c.velocity_feedforward * velocity[k]
        error = held - speed
        ki = c.kv / c.reset_time if c.reset_time else c.ki
        further = integral + ki * PERIOD * error
        force = c.kv * error + further
        if c.feedforward is not None:
            damping = 400.0 if velocity[k] >= 0 else 200.0
            share = 1.0 if c.force_feedforward is None else c.force_feedforward
            force += share * (120.0 * acceleration[k] + damping * velocity[k])
        if c.force_limit is None:
            integral = further
        else:
            beyond = abs(force) > c.force_limit and error * force > 0.0
            integral = integral if beyond else further
            force = np.clip(force, -c.force_limit, c.force_limit)
        forces.append(force)
    forces = np.array(forces)
    for one in c.filters:
        found = by_python_control(one)
        forces = lfilter(found.num[0][0], found.den[0][0], forces)
    return forces


@pytest.mark.parametrize("name", [*ONE_EACH, "whole"])
def test_a_run_s_command_is_that_of_a_loop_in_numpy(name):
    controller = ONE_EACH.get(name, WHOLE)
    run = simulate_loop(ROUGH, controller, MOVE, sampling=Sampling(RATE)).require_ok()
    expected = commands_in_numpy(controller, run.reference, run.reference_velocity, MOVE.acceleration, run.position)
    np.testing.assert_allclose(run.command, expected, rtol=0, atol=1e-8 * np.max(np.abs(expected)))
    if name == "limit":
        assert np.max(np.abs(run.command)) == 150.0


def test_a_reset_time_is_an_integral_gain():
    one, other = (
        simulate_loop(ROUGH, c, MOVE, sampling=Sampling(RATE)).command
        for c in (Cascade(120.0, 2e4, reset_time=0.02), Cascade(120.0, 2e4, 1e6))
    )
    np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_the_smooth_variant_may_be_made_inside_a_traced_function():
    """There no number is known, and so none is refused."""
    made = jax.jit(lambda controller: smooth(controller))(as_arrays(WHOLE))
    assert float(made.limit_rounding) == pytest.approx(9.0)
    lanes = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (3,)), as_arrays(WHOLE))
    assert jax.vmap(smooth)(lanes).limit_rounding.shape == (3,)
    assert smooth(Cascade(1.0, 1.0)) == Cascade(1.0, 1.0)


def test_what_a_cascade_leaves_out_costs_nothing():
    """Not one operation or number more: what is absent is not there."""
    plain = Cascade(120.0, 2e4, 1e6)
    state = plain.init(jnp.zeros(()))
    assert len(jax.tree.leaves(state)) == 3
    assert len(jax.tree.leaves(as_arrays(plain))) == 4

    def operations(controller):
        def step(state, position):
            reference = Reference(position, position, position)
            return controller.step(state, reference, position, position, PERIOD)

        return len(jax.make_jaxpr(step)(controller.init(jnp.zeros(())), jnp.zeros(())).eqns)

    # the history's start (4), difference (3), set-point (4), PI (6), and the flag
    assert operations(as_arrays(plain)) <= 18
    assert operations(as_arrays(ONE_EACH["one notch"])) > operations(as_arrays(plain))


def test_an_integral_that_is_held_at_the_limit_comes_back_at_once():
    """Pushed beyond its limit for half a second: with windup the table would overshoot as long again."""
    still = motions.from_array(np.arange(8_000) / RATE, np.r_[np.zeros(400), np.full(7_600, 2e-3)])
    limit = 300.0
    held = simulate_loop(IDEAL, Cascade(100.0, 2e4, 2e6, force_limit=limit), still, sampling=Sampling(RATE))
    weak = dataclasses.replace(IDEAL, actuator=Actuator(force_limit=limit))
    wound = simulate_loop(weak, Cascade(100.0, 2e4, 2e6), still, sampling=Sampling(RATE))
    assert np.max(np.abs(held.command)) == limit
    beyond = [np.max(run.table_position) - 2e-3 for run in (held, wound)]
    assert beyond[0] < 0.5 * beyond[1]


def test_of_the_smooth_limit_little_is_felt_inside_it():
    c = dataclasses.replace(ONE_EACH["limit"], force_limit=2_000.0)
    exact, rounded = (simulate_loop(IDEAL, one, MOVE, sampling=Sampling(RATE)).command for one in (c, smooth(c)))
    np.testing.assert_allclose(rounded, exact, rtol=1e-9, atol=1e-9)
    near = dataclasses.replace(c, force_limit=140.0)
    exact, rounded = (simulate_loop(IDEAL, one, MOVE, sampling=Sampling(RATE)).command for one in (near, smooth(near)))
    assert np.max(np.abs(exact)) == 140.0
    assert np.max(np.abs(rounded - exact)) < 0.05 * 140.0


def test_a_set_point_that_waits_for_the_speed_feedforward_takes_its_lag_away():
    """A velocity loop that lags by T follows a ramp without error where the set-point lags by T as well."""
    ramp = motions.jerk_limited(distance=8e-3, speed=0.02, acceleration=1.0, jerk=50.0, rate=RATE, dwell=0.0)
    plain = Cascade(80.0, 2e4, velocity_feedforward=1.0, feedforward=Feedforward.of(IDEAL.plant), reset_time=0.01,
                    velocity_filter_time=1e-3)  # fmt: skip
    errors = [
        simulate_loop(IDEAL, c, ramp, sampling=Sampling(RATE)).rms_error()
        for c in (plain, dataclasses.replace(plain, reference_filter_time=1e-3))
    ]
    assert errors[0] != errors[1]


@pytest.mark.parametrize("every", [2, 5, 40])
def test_a_slow_sinusoid_through_a_held_loop_is_that_of_its_smooth_variant(every):
    """The spectral line of the command at the frequency of the position, which the hold shifts and lowers."""
    exact = Cascade(300.0, 2e4, 1e6, position_every=every)
    n, cycles = 4_000, 30  # the hold's own lines fall elsewhere
    position = 1e-5 * np.cos(2 * np.pi * cycles * np.arange(2 * n) / n)

    def line(controller):
        def body(state, y):
            zero = jnp.zeros(())
            state, command = controller.step(state, Reference(zero, zero, zero), y, zero, PERIOD)
            return state, command.force

        commands = jax.lax.scan(body, controller.init(jnp.asarray(position[0])), jnp.asarray(position))[1]
        return np.fft.fft(np.asarray(commands)[n:])[cycles]

    assert line(smooth(exact)) == pytest.approx(line(exact), rel=1e-9)
