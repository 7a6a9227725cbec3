"""The plant and its friction against an independent reference solution, conservation laws and known steady states."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from scipy.integrate import solve_ivp

from diffdrive import motion
from diffdrive.controllers import PD, PDGains, Tracking
from diffdrive.effects.friction import PositionFriction
from diffdrive.errors import ParameterError
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Drive, Friction, Plant, Sampling
from diffdrive.model.plant import PlantState, advance
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.numerics.arrays import as_arrays

PERIOD = 1e-4
LOAD = 5_000.0
STIFFNESS, DAMPING, MASS = 3.35e7, 4.54e3, 100.0
SIDES = {
    +1: SimpleNamespace(screw=63.43, gap=30.0, stribeck=0.0010, viscous=1826.5, system=380.0),
    -1: SimpleNamespace(screw=64.95, gap=22.98, stribeck=0.0014, viscous=1673.5, system=260.0),
}


def level(side, speed, load=LOAD):
    p = SIDES[side]
    return p.screw + 3.66e-4 * (15_200.0 + load) + p.gap * np.exp(-speed / p.stribeck)


def equations(time, state, side, force):
    _, v, z = state
    slip = v - STIFFNESS * side * v * z / level(side, side * v)
    p = SIDES[side]
    friction = STIFFNESS * z + DAMPING * slip + p.viscous * v
    return [v, (force - p.system * v - friction) / MASS, slip]


def jacobian(time, state, side, force):
    _, v, z = state
    p, g = SIDES[side], level(side, side * v)
    fall = -side * p.gap / p.stribeck * np.exp(-side * v / p.stribeck)
    slip_v = 1 - STIFFNESS * side * z / g * (1 - v * fall / g)
    slip_z = -STIFFNESS * side * v / g
    return [
        [0, 1, 0],
        [0, (-p.system - p.viscous - DAMPING * slip_v) / MASS, (-STIFFNESS - DAMPING * slip_z) / MASS],
        [0, slip_v, slip_z],
    ]


def stopped(time, state, side, force):
    return state[1]


stopped.terminal = True


def reference_advance(state, side, force, duration):
    """Radau to rounding, in pieces of one direction of motion each; returns the state and its direction."""
    time = 0.0
    while True:
        stopped.direction = -side
        piece = solve_ivp(
            equations, (time, duration), state, "Radau", args=(side, force), jac=jacobian, events=stopped,
            rtol=1e-12, atol=[1e-16, 1e-14, 1e-18],
        )  # fmt: skip
        state, time = piece.y[:, -1], piece.t[-1]
        if piece.status == 0:
            return state, side
        side = 1 if equations(time, state, side, force)[1] > 0 else -1


def reversal(speed, duration, rounding):
    """Reference positions at each sample: to and fro at `speed`, the reversal linear in velocity, centred."""
    t = np.arange(round(duration / PERIOD) + 1) * PERIOD - duration / 2
    ramp = np.clip(t, -rounding / 2, rounding / 2)
    return -speed * (np.abs(t) - np.abs(ramp) + ramp**2 / rounding) + speed * duration / 2


def feedback(error, last):
    return PAPER_KP * error + PAPER_KD * (error - last) / PERIOD


def reference_loop(reference, speed):
    state, side = np.array([reference[0], speed, level(1, speed) / STIFFNESS]), 1
    last, positions = 0.0, []
    for wanted in reference[:-1]:
        error = wanted - state[0]
        state, side = reference_advance(state, side, feedback(error, last), PERIOD)
        positions.append(state[0])
        last = error
    return np.array(positions)


@jax.jit
def loop(drive, reference, speed, deflection):
    def body(carry, wanted):
        state, last = carry
        error = wanted - state.position
        state = advance(drive, state, feedback(error, last), LOAD, PERIOD, Sampling().plant_steps)
        return (state, error), state.position

    start = PlantState(reference[0], speed, deflection)
    return lax.scan(body, (start, 0.0), reference[:-1])[1]


def error_in_the_loop(drive, speed, duration):
    reference = reversal(speed, duration, duration / 3)
    ours = loop(drive, jnp.asarray(reference), speed, level(1, speed) / STIFFNESS)
    exact = reference_loop(reference, speed)
    assert np.ptp(exact) > 0.3 * speed * duration
    return np.abs(np.asarray(ours) - exact).max()


@pytest.mark.long
@pytest.mark.parametrize("speed", [*(pytest.param(one, marks=pytest.mark.slow) for one in (2e-4, 0.01)), 0.2])
def test_plant_in_the_loop_is_within_a_tenth_of_a_nanometre(drive, speed):
    assert error_in_the_loop(drive, speed, 0.5) <= 1e-10


@pytest.mark.parametrize(("speed", "coarsest"), [(2e-4, 64), (0.01, 16), (0.2, 16)])
def test_second_order(drive, speed, coarsest):
    """From steady sliding, the force 10 N up: no reversal, so the order is the scheme's own.

    In creep the error of longer steps is smaller than their order lets expect, and above it finer ones meet rounding.
    """
    duration, period = 0.02, 1e-3
    start = [0.0, speed, level(1, speed) / STIFFNESS]
    force = float(steady_friction(drive.friction, speed, LOAD)) + 380.0 * speed + 10.0
    exact, _ = reference_advance(np.array(start), 1, force, duration)
    substeps, errors = coarsest * np.array([1, 2, 4, 8]), []
    for n in substeps:

        def body(state, _, n=int(n)):
            return advance(drive, state, force, LOAD, period, n), None

        state, _ = jax.jit(lambda body=body: lax.scan(body, PlantState(*start), None, length=20))()
        errors.append(np.abs(np.array(state) - exact) / np.abs(exact))
    slopes = -np.polyfit(np.log(substeps), np.log(np.array(errors)), 1)[0]
    assert np.all((slopes > 1.7) & (slopes < 2.6)), slopes


@partial(jax.jit, static_argnums=4)
def free(drive, velocity, deflection, step, substeps):
    return advance(drive, PlantState(0.0, velocity, deflection), 0.0, 0.0, step * substeps, substeps)


def decades(low, high):
    return st.floats(np.log10(low), np.log10(high)).map(lambda exponent: 10.0**exponent)


def assert_energy_does_not_grow(drive, mass, stiffness, step, velocity, bent, substeps):
    paper = [getattr(drive.friction, name) for name in Friction.__dataclass_fields__]
    friction = Friction(*paper[:6], stiffness, drive.friction.bristle_damping)
    deflection = bent * level(1 if bent >= 0 else -1, 0.0, 0.0) / stiffness
    table = as_arrays(Drive(Plant(mass, drive.plant.damping), friction))
    after = free(table, velocity, deflection, step, substeps)
    before = mass * velocity**2 / 2 + stiffness * deflection**2 / 2
    energy = mass * after.velocity**2 / 2 + stiffness * after.bristle**2 / 2
    assert energy <= before * (1 + 1e-9) + 1e-300


FREE_MOTION = {
    "stiffness": decades(1e3, 1e9),
    "step": decades(1e-6, 5e-3),
    "velocity": st.floats(-0.2, 0.2),
    "bent": st.floats(-1, 1),
}


# from 10 kg up: below, a single step of milliseconds may gain (docs/method/numerics.md)
@pytest.mark.long
@settings(max_examples=300, deadline=None, derandomize=True)
@given(mass=decades(10.0, 1e4), **FREE_MOTION)
def test_energy_never_grows_without_force(drive, mass, stiffness, step, velocity, bent):
    assert_energy_does_not_grow(drive, mass, stiffness, step, velocity, bent, 1)


@pytest.mark.long
@settings(max_examples=300, deadline=None, derandomize=True)
@given(mass=decades(10.0, 1e4), **FREE_MOTION)
def test_energy_never_grows_over_several_substeps(drive, mass, stiffness, step, velocity, bent):
    assert_energy_does_not_grow(drive, mass, stiffness, step, velocity, bent, 3)


@pytest.mark.parametrize("speed", [-0.2, -0.01, -1e-3, 2e-3, 0.01, 0.2])
def test_steady_sliding_is_on_the_stribeck_curve(drive, speed):
    side = 1 if speed > 0 else -1
    resistance = side * level(side, abs(speed)) + SIDES[side].viscous * speed
    np.testing.assert_allclose(steady_friction(drive.friction, speed, LOAD), resistance, rtol=1e-14)
    start = PlantState(0.0, speed, side * level(side, abs(speed)) / STIFFNESS)
    state = advance(drive, start, resistance + SIDES[side].system * speed, LOAD, 0.01, 800)
    np.testing.assert_allclose(state, [0.01 * speed, *start[1:]], rtol=1e-9)


def test_friction_at_ten_millimetres_per_second(drive):
    assert abs(steady_friction(drive.friction, 0.01) - 87.3) < 0.05


STATIC_ERRORS = [(0.01, 0.0, 11.411e-6), (0.01, 1e4, 11.870e-6), (-0.01, 0.0, -11.262e-6), (-0.01, 1e4, -11.721e-6)]


@pytest.mark.parametrize(("speed", "load", "error"), STATIC_ERRORS)
def test_static_errors_of_pd(drive, speed, load, error):
    time = np.arange(5001) * PERIOD
    ramp = motion.from_array(time, speed * np.where(time < 0.1, time**2 / 0.2, time - 0.05))
    run = simulate_loop(drive, PD(Tracking(PDGains(PAPER_KP, PAPER_KD))), ramp, load)
    np.testing.assert_allclose(run.error[-100:], error, rtol=1e-4)


def test_momentum_balance(drive):
    """M dv is the integral of force minus damping minus friction, over a pull through breakaway and back."""
    time = np.arange(40_001) * 1e-5
    force = 130.0 * np.sin(2 * np.pi * 2.5 * time)

    def body(state, force):
        state = advance(drive, state, force, LOAD, 1e-5, 1)
        return state, state

    _, (_, v, z) = lax.scan(body, PlantState(0.0, 0.0, 0.0), jnp.asarray(force))
    v, z = np.asarray(v), np.asarray(z)
    sides = [np.array([getattr(SIDES[1 if p >= 0 else -1], name) for p in v]) for name in ("viscous", "system")]
    g = np.where(v >= 0, level(1, np.abs(v)), level(-1, np.abs(v)))
    resistance = STIFFNESS * z + DAMPING * (v - STIFFNESS * np.abs(v) * z / g) + sum(sides) * v
    impulse = np.cumsum(force[1:] - (resistance[1:] + resistance[:-1]) / 2) * 1e-5
    assert np.abs(v).max() > 5e-3
    np.testing.assert_allclose(MASS * (v[1:] - v[0]), impulse, atol=1e-5 * MASS * np.abs(v).max())


def test_mirrored_motion_gives_the_mirrored_result(drive):
    fields = {name: getattr(drive.friction, name) for name in Friction.__dataclass_fields__}
    same = {name: getattr(value, "positive", value) for name, value in fields.items()}
    symmetric = Drive(Plant(100.0, 380.0), Friction(**same))
    pd = PD(Tracking(PDGains(PAPER_KP, PAPER_KD)))
    there = motion.sine(amplitude=3e-4, frequency=5.0, duration=0.4, rate=1e4)
    back = replace(there, position=-there.position, velocity=-there.velocity, acceleration=-there.acceleration)
    run, mirrored = simulate_loop(symmetric, pd, there, LOAD), simulate_loop(symmetric, pd, back, LOAD)
    for signal in ("table_position", "velocity", "command", "friction"):
        a, b = getattr(run, signal), getattr(mirrored, signal)
        np.testing.assert_allclose(a, -b, atol=1e-12 * np.abs(a).max())


@pytest.mark.parametrize("velocity", [0.0, 1e-3, -0.1])
def test_a_friction_level_below_zero_is_no_friction(drive, velocity):
    """An effect may take more Coulomb friction than there is: that run must not look like one."""
    friction = replace(drive.friction, coulomb_screw=jax.tree.map(lambda _: -1000.0, drive.friction.coulomb_screw))
    state = PlantState(jnp.asarray(0.0), jnp.asarray(velocity), jnp.asarray(1e-7))
    assert np.isnan(float(advance(replace(drive, friction=friction), state, 10.0, 0.0, PERIOD, 5).velocity))


def test_a_motion_into_such_a_friction_is_refused_or_no_number(drive):
    """`simulate_loop` says so before it begins; the pure function, which cannot look at its input, has no number."""
    along = replace(drive, effects=(PositionFriction(slope=-20.0),))
    pd = PD(Tracking(PDGains(PAPER_KP, PAPER_KD)))
    reference = motion.triangular(speed=0.2, stroke=0.09, rounding=0.1, duration=1.0, rate=10_000.0)
    with pytest.raises(ParameterError, match="it takes 180 % of the Coulomb friction off at some place"):
        simulate_loop(along, pd, reference)
    inputs = loop_inputs(reference, np.zeros(len(reference.time)))
    position = np.asarray(rollout_loop(*as_arrays((along, pd)), inputs, Sampling()).table_position)
    reached = np.isfinite(position)
    assert reached[0]
    assert not reached[-1]
    assert np.max(position[reached]) < 0.051  # where the slope has taken all of it
