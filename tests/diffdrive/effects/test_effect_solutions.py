"""Single effects against solutions of their own: oscillator, lag, delay, contact age, presliding, a gap, a frame."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

from diffdrive.effects import stages
from diffdrive.effects.actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.base import Seen
from diffdrive.effects.forces import FrameVibration, window
from diffdrive.effects.friction import FrictionDwell, PositionFriction, PreslidingHysteresis
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.errors import ParameterError
from diffdrive.loop.linearise import OperatingPoint, open_loop, response
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import check_drive
from diffdrive.model.plant import advance, at_rest
from diffdrive.motion.builders import triangular
from diffdrive.numerics.arrays import as_arrays
from diffdrive.numerics.oscillator import Oscillator, discretise
from tests.support.driven_effects import CONTROLLER, DRIVE, RATE, SAMPLING, with_effects


@pytest.mark.parametrize("effect", [Compliance, Backlash, FrameVibration])
def test_what_does_not_swing_is_no_oscillator(effect):
    with pytest.raises(ParameterError, match=rf"effects\.{effect.name}\.damping must be below 1"):
        check_drive(with_effects(effect(damping=1.0)))


@pytest.mark.parametrize("damping", [0.0, 0.1, 0.9985, 0.9995, 0.99999])
def test_an_oscillator_is_stepped_exactly(damping):
    push, angular = 3.0, 40.0

    def rates(_, q):
        return [q[1], push - 2 * damping * angular * q[1] - angular**2 * q[0]]

    found = scipy.integrate.solve_ivp(rates, (0, 0.13), [1e-3, -0.2], method="DOP853", rtol=1e-12, atol=1e-15)
    ours = discretise(angular, damping, 0.13).step(Oscillator(1e-3, -0.2), push)
    np.testing.assert_allclose([float(ours.deflection), float(ours.rate)], found.y[:, -1], rtol=1e-9)

    def end(damping):
        after = discretise(angular, damping, 0.13).step(Oscillator(1e-3, -0.2), push)
        return jnp.stack([after.deflection, after.rate])

    slope, step = jax.jvp(end, (damping,), (1.0,))[1], 4e-6
    difference = (end(damping + step) - end(damping - step)) / (2.0 * step)
    np.testing.assert_allclose(slope, difference, rtol=1e-5)
    assert np.all(np.asarray(slope) != 0.0)


def test_a_lag_passes_on_the_mean_of_an_exponential():
    lag, period = ActuatorLag(4e-4), 5e-4
    state, (mean, tilt) = lag.step(10.0, 30.0, period)
    time = np.linspace(0, period, 20_001)
    force = 30.0 - 20.0 * np.exp(-time / 4e-4)
    assert float(state) == pytest.approx(force[-1], rel=1e-9)
    assert float(mean) == pytest.approx(np.trapezoid(force, time) / period, rel=1e-8)
    # the straight line carries a free mass as far as the exponential does
    line = float(mean) + float(tilt) * (time / period - 0.5)
    left = period - time
    assert np.trapezoid(left * line, time) == pytest.approx(np.trapezoid(left * force, time), rel=1e-8)


@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.7, 8.0])
def test_a_delay_moves_a_ramp(delay):
    one = LoopDelay(delay)
    state, out = one.init(jnp.asarray(0.0)), []
    for k in range(40):
        state, (force, tilt) = one.step(state, jnp.asarray(float(k)), 1e-3)
        out.append(float(force))
        part = delay % 1.0
        if k > 10:  # a step of one newton `part` of the way through the period
            assert float(tilt) == pytest.approx(6.0 * part * (1.0 - part), abs=1e-12)
    np.testing.assert_allclose(out[10:], np.arange(10.0, 40.0) - delay, rtol=1e-12)


def test_the_force_is_scaled_before_it_is_limited_whatever_the_order():
    for effects in ((ForceGain(-0.2), ForceLimit(100.0)), (ForceLimit(100.0), ForceGain(-0.2))):
        states = stages.initial_states(effects, jnp.zeros(()))
        assert stages.actuator_output(effects, states, jnp.asarray(110.0), 1e-3)[1].mean == pytest.approx(88.0)
        assert stages.actuator_output(effects, states, jnp.asarray(200.0), 1e-3)[1].mean == pytest.approx(100.0)


@pytest.mark.parametrize("behind", [LoopDelay(0.5), ActuatorLag(2e-3)])
def test_a_command_is_limited_before_it_is_late_or_lags(behind):
    """Behind them only the mean of a period would be."""
    effects = (behind, ForceLimit(100.0))
    states, (alone,) = stages.initial_states(effects, jnp.zeros(())), stages.initial_states((behind,), jnp.zeros(()))
    found = stages.actuator_output(effects, states, jnp.asarray(1000.0), 1e-3)[1]
    expected = behind.step(alone, jnp.asarray(100.0), 1e-3)[1]
    assert found.mean == pytest.approx(expected.mean)
    assert found.slope == pytest.approx(expected.slope)


@pytest.mark.parametrize(("gain", "own", "most"), [(1.0, None, 50.0), (-0.5, None, 200.0), (-0.5, 150.0, 150.0)])
def test_saturation_is_told_of_the_command(gain, own, most):
    limited = dataclasses.replace(DRIVE, actuator=dataclasses.replace(DRIVE.actuator, force_limit=own))
    drive = dataclasses.replace(limited, effects=(ForceGain(gain), ForceLimit(100.0)))
    assert float(stages.force_limit(drive)) == pytest.approx(most)
    assert stages.force_limit(dataclasses.replace(DRIVE, effects=(ForceGain(gain),))) is None


def test_the_friction_recorded_is_that_which_acts():
    """A force balance: what accelerates the table is the force less damping and the friction recorded."""
    drive = with_effects(PositionFriction(0.0, 0.0, 0.02, 0.3, 0.0))
    fast = triangular(speed=0.1, stroke=0.0375, rounding=0.05, duration=0.4, rate=RATE)
    frame = rollout_loop(*as_arrays((drive, CONTROLLER)), loop_inputs(fast, np.zeros(len(fast.time))), SAMPLING)
    speed, friction = np.asarray(frame.velocity), np.asarray(frame.friction)
    resisting = friction + float(drive.plant.damping.positive) * speed
    halfway = 0.5 * (resisting[1:] + resisting[:-1])
    off = drive.plant.mass * np.diff(speed) * RATE - (np.asarray(frame.force)[:-1] - halfway)
    fastest = speed[:-1] > 0.09
    assert np.std(friction[:-1][fastest]) > 10.0
    assert np.sqrt(np.mean(off[fastest] ** 2)) < 5.0  # that of a machine without the wave is off by 95 N


@pytest.mark.long
def test_a_lag_turns_the_loop_as_its_transfer_function_does():
    drive = dataclasses.replace(DRIVE, actuator=dataclasses.replace(DRIVE.actuator, delay_samples=1))
    lag = ActuatorLag(8e-4)
    frequency = np.array([5.0, 30.0, 120.0])
    plain, turned = (
        response(open_loop(*as_arrays((smooth(one), CONTROLLER)), SAMPLING, OperatingPoint(0.01, 0.0)), frequency).loop
        for one in (drive, with_effects(lag, drive=drive))
    )
    z = np.exp(2j * np.pi * frequency / RATE)
    share = 8e-4 * RATE
    fade = np.exp(-1.0 / share)
    c = share * (1.0 - fade)
    np.testing.assert_allclose(turned / plain, (1.0 - c) + c * (1.0 - fade) / (z - fade), rtol=1e-6)


@pytest.mark.long
def test_age_grows_at_rest_and_is_forgotten_over_a_slip():
    dwell = FrictionDwell(1.0, 0.1, 1e-5)
    drive, age = as_arrays(DRIVE), jnp.zeros(())
    for velocity, time in ((0.0, 1.0), (1e-3, 0.02)):
        seen = Seen(0.0, 0.0, jnp.asarray(velocity), 0.0, 0.0, 0.0, 0.0)
        for _ in range(round(time / 1e-3)):
            age, acts = dwell.step(age, seen, drive, 1e-3)
        if velocity == 0.0:
            assert float(age) == pytest.approx(1.0)
            gap = float(drive.friction.breakaway_gap.positive)
            assert float(acts.gap) == pytest.approx(gap * np.log(11.0), rel=2e-3)
    # after two slip distances: exp(-2) of it, and the age of steady sliding
    assert float(age) == pytest.approx(0.01 + 0.99 * np.exp(-2.0), rel=1e-6)


def test_maxwell_elements_carry_in_sliding_what_the_bristle_carried():
    """No difference in steady sliding; a closed loop of small strokes is another hysteresis."""
    one, drive = PreslidingHysteresis(1.0, 5e-6, 0.2), as_arrays(DRIVE)
    state = one.init()

    @functools.partial(jax.jit, static_argnums=2)
    def stepped(state, speed, period):
        return one.step(state, Seen(0.0, 0.0, speed, 0.0, 0.0, 0.0, 0.0), drive, period)

    for _ in range(200):
        state, acts = stepped(state, jnp.asarray(0.01), 1e-4)
    assert abs(float(acts.force)) < 1e-3
    state, acts = stepped(state, jnp.asarray(-0.005), 5e-4)
    assert abs(float(acts.force)) > 1.0


def test_a_window_is_one_inside():
    time = np.array([0.0, 1.5, 3.0])
    np.testing.assert_allclose(window(time, 1.0, 2.0), [0.0, 1.0, 0.0], atol=1e-12)


def test_a_ripple_of_the_force_moves_the_motor_within_its_gap():
    """Free between the sides of a wide gap: twice integrated, period by period; a constant ripple is more force."""
    friction = DRIVE.friction
    nearly_none = {
        name: jax.tree.map(lambda value: 1e-9 * value, getattr(friction, name))
        for name in ("coulomb_screw", "load_coefficient", "breakaway_gap", "viscous")
    }
    bare = as_arrays(dataclasses.replace(DRIVE, friction=dataclasses.replace(friction, **nearly_none)))
    effect, period = as_arrays(Backlash(1e-3, 400.0, 0.1, 0.3, 0.6)), 5e-4
    ripple = jnp.asarray([9.0, -4.0, 6.0, -8.0, -3.0])

    def deflected(force, ripple):
        seen = stages.seen_by(bare, 0.0, 0.0, 0.0, 0.0, force, 0.0, 0.0)._replace(ripple=ripple)
        return effect.step(effect.init(), seen, bare, period)[0].relative

    level, rippled = deflected(5.0, None), deflected(5.0, ripple)
    part = period / len(ripple)
    left = part * (len(ripple) - 0.5 - np.arange(len(ripple)))  # s, from the middle of each part to the end
    moved = float(np.sum(ripple * part * left)) / (0.3 * float(bare.plant.mass))
    assert float(rippled.deflection - level.deflection) == pytest.approx(moved, rel=5e-3)  # friction is small, not none
    assert float(rippled.rate) == pytest.approx(float(level.rate), rel=2e-3)
    more = deflected(5.0, jnp.full(5, 2.0))
    assert float(more.deflection) == pytest.approx(float(deflected(7.0, None).deflection), rel=1e-9)


def test_a_vibrating_frame_is_two_bodies():
    """Table and base written out, without friction."""
    friction = DRIVE.friction
    nearly_none = {
        name: jax.tree.map(lambda value: 1e-6 * value, getattr(friction, name))
        for name in ("coulomb_screw", "load_coefficient", "breakaway_gap")
    }
    bare = dataclasses.replace(DRIVE, friction=dataclasses.replace(friction, **nearly_none))
    effect = FrameVibration(0.2, 15.0, 0.05)
    period, w, mass = 1.0 / RATE, 2 * np.pi * 15.0, float(bare.plant.mass)
    drag = float(bare.friction.viscous.positive + bare.plant.damping.positive)
    force = 40.0

    def rates(_, y):
        _, v, xb, vb = y  # table and base against the ground
        net = force - drag * (v - vb)
        return [v, net / mass, vb, -0.2 * net / mass - 2 * 0.05 * w * vb - w**2 * xb]

    found = scipy.integrate.solve_ivp(rates, (0, 0.3), [0, 0, 0, 0], method="DOP853", rtol=1e-10, atol=1e-14)
    machine = as_arrays(dataclasses.replace(bare, effects=(effect,)))

    def body(carry, k):
        table, states = carry
        seen = stages.seen_by(machine, k * period, *table, force, 0.0, 0.0)
        states, acts = stages.table_action(machine.effects, states, seen, machine, period)
        return (advance(machine, table, force + acts.force, 0.0, period, 40), states), None

    begin = (at_rest(0.0), stages.initial_states(machine.effects, 0.0))
    (table, _), _ = jax.lax.scan(body, begin, jnp.arange(round(0.3 * RATE), dtype=float))
    assert float(table.position) == pytest.approx(found.y[0, -1] - found.y[2, -1], rel=2e-3)
