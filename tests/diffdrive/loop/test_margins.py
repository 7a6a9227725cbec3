"""Margins against python-control, against gains at which the simulated loop falls apart, and their derivatives."""

from functools import cache

import control
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.controllers import PD, Reference
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.loop.linearise import OpenLoop, OperatingPoint, open_loop
from diffdrive.loop.margins import NEUTRAL_GROWTH, Margins, margins
from diffdrive.loop.rollout import rollout_loop
from diffdrive.loop.step import Inputs, initial_state
from diffdrive.model.friction import steady_friction, stribeck_level
from diffdrive.model.parameters import Drive, Plant, Sampling
from diffdrive.model.plant import PlantState
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.numerics.arrays import as_arrays
from tests.diffdrive.loop.test_linearise import (
    FRACTIONAL,
    LOADS,
    ONE_SAMPLE,
    PERIOD,
    VELOCITIES,
    drive_with,
    growth,
    loop_of,
    loops_of,
    response,
    simulated,
    smooth_controller,
    with_gain,
)

pytestmark = pytest.mark.slow  # two minutes of compiling many loops
PAPER = paper_drive()
MOST_STATES = 15


def padded(loop):
    """The loops [p] with states added that nothing moves: all loops are of one size, and `margins` is compiled once."""
    add, no = (0, MOST_STATES - loop.b.shape[-1]), (0, 0)
    a, b, c = jnp.pad(loop.a, [no, add, add]), jnp.pad(loop.b, [no, add]), jnp.pad(loop.c, [no, add])
    return OpenLoop(a, b, c, loop.period)


all_margins = jax.jit(jax.vmap(margins))


@cache
def margins_of(name, delay=ONE_SAMPLE):
    return jax.tree.map(np.asarray, all_margins(padded(loops_of(name, delay))))


def margins_at(name, point, delay=ONE_SAMPLE):
    return Margins(*(float(leaf[point]) for leaf in margins_of(name, delay)))


def by_python_control(loop):
    """Gain margins up and down (factors), phase margin (rad) and Ms, from the loop's response on a fine grid."""
    frequency = np.geomspace(0.5, 4999.0, 1000)
    found = control.ss(loop.a, loop.b[:, None], -loop.c[None], 0.0, loop.period)(
        np.exp(2j * np.pi * frequency * loop.period)
    )
    sampled = control.FRD(found, 2 * np.pi * frequency, smooth=True)  # polynomials find crossings that are none
    gain, phase, distance, *_ = control.stability_margins(sampled, returnall=True)
    gain, phase = np.abs(gain), np.abs((np.asarray(phase) + 180.0) % 360.0 - 180.0)
    up, down = gain[gain > 1.0], gain[gain < 1.0]
    return (
        np.min(up, initial=np.inf),
        1.0 / np.max(down) if len(down) else np.inf,
        np.radians(np.min(phase, initial=np.inf)),
        1.0 / np.min(distance),
    )


@pytest.mark.parametrize(
    ("name", "delay"),
    [
        ("PD", ONE_SAMPLE),
        ("DOBVSC", ONE_SAMPLE),
        ("PD+FF+DOB", ONE_SAMPLE),
        ("PD+FC+LE", ONE_SAMPLE),
        ("PD+FC+LS", ONE_SAMPLE),
        ("cascade", FRACTIONAL),
    ],
)
def test_margins_are_those_of_python_control(name, delay):
    for point in range(len(VELOCITIES)):
        ours = margins_at(name, point, delay)
        theirs = by_python_control(loop_of(name, point, delay))
        np.testing.assert_allclose((ours.gain_up, ours.gain_down, ours.phase, ours.sensitivity), theirs, rtol=1e-6)


def test_phase_margins_are_those_of_the_notes():
    """32.8, 30.0 and 16.6 degrees: the falling Stribeck curve takes damping from a slow table."""
    drive, controller = drive_with(ONE_SAMPLE), smooth_controller("PD")
    loops = jax.jit(jax.vmap(lambda v: open_loop(drive, controller, Sampling(), OperatingPoint(v, 0.0))))
    phase = np.degrees(all_margins(padded(loops(1e-3 * np.array([10, 3, 1, 10, 3, 1])))).phase)
    np.testing.assert_allclose(phase[:3], [32.8, 30.0, 16.6], atol=0.06)


@pytest.mark.parametrize("name", ["PD", "DOBVSC", "PD+FF+DOB", "PD+FC+LE", "PD+FC+LS"])
def test_growth_is_that_of_the_spectral_radius(name):
    for point in range(len(VELOCITIES)):
        loop = loop_of(name, point)
        radius = np.max(np.abs(np.linalg.eigvals(loop.closed_loop)))
        np.testing.assert_allclose(growth(loop), np.log(radius) / PERIOD, rtol=1e-6, atol=1e-4)


def gains_that_hold(loop):
    """The range of gains about 1 in which no mode grows, by eigenvalues alone."""

    def grows(gain):
        return np.max(np.abs(np.linalg.eigvals(loop.a + gain * np.outer(loop.b, loop.c)))) > 1.0 + 1e-9

    found = []
    for sign in (1.0, -1.0):
        factors = np.geomspace(1.0, 1000.0, 400)
        first = next((k for k, factor in enumerate(factors) if grows(factor**sign)), None)
        if first is None:
            found.append(np.inf)
            continue
        low, high = factors[first - 1], factors[first]
        for _ in range(20):
            middle = np.sqrt(low * high)
            low, high = (low, middle) if grows(middle**sign) else (middle, high)
        found.append(low)
    return found


@pytest.mark.parametrize("name", ["PD", "DOBVSC", "PD+FF+DOB", "PD+FC+LE", "PD+FC+LS"])
def test_gain_margins_are_where_the_first_mode_grows(name):
    for point in range(len(VELOCITIES)):
        found = margins_at(name, point)
        up, down = gains_that_hold(loop_of(name, point))
        np.testing.assert_allclose((found.gain_up, found.gain_down), (up, down), rtol=2e-4)


def envelope_rate(signal, period):
    """Growth rate (1/s) of a decaying or growing oscillation, by its largest values in the two later thirds."""
    _, before, after = np.abs(np.asarray(signal)[: len(signal) // 3 * 3]).reshape(3, -1)
    return np.log(np.max(after) / np.max(before)) / (len(before) * period)


@cache
def pushed_pd(velocity, load, seconds):
    """The simulator's position (m) beside a steady motion after a push of a millinewton, for a factor on kp and kd.

    It begins in the steady motion, with the error that PD needs to hold friction.
    """
    drive = drive_with(ONE_SAMPLE)
    steps = round(seconds / PERIOD)

    @jax.jit
    def run(factor):
        controller = PD(Tracking(PDGains(factor * PAPER_KP, factor * PAPER_KD)))
        force = steady_friction(drive.friction, velocity, load) + drive.plant.damping.towards(velocity) * velocity
        deflection = jnp.sign(velocity) * stribeck_level(drive.friction, velocity, load) / 3.35e7
        begin = initial_state(drive, controller, jnp.zeros(()))
        begin = begin._replace(
            plant=PlantState(jnp.zeros(()), jnp.asarray(velocity), deflection),
            actuator=jax.tree.map(lambda _: force, begin.actuator),
        )
        way = velocity * PERIOD * jnp.arange(steps)
        reference = Reference(way + force / (factor * PAPER_KP), jnp.full(steps, velocity), jnp.zeros(steps))
        push = jnp.zeros(steps).at[0].set(1e-3)
        inputs = Inputs(reference, jnp.full(steps, load), push)
        return rollout_loop(drive, controller, inputs, Sampling(), begin=begin).table_position - way

    return run


def factor_at(margin, side, beyond):
    return beyond * margin if side == "gain_up" else 1.0 / (beyond * margin)


@pytest.mark.parametrize(
    ("point", "side", "seconds"), [(2, "gain_up", 0.03), (1, "gain_up", 0.03), (1, "gain_down", 0.9)]
)
def test_pd_is_lost_in_simulation_just_beyond_its_gain_margin(point, side, seconds):
    """At 0.3 mm/s by too little gain as well: there the falling Stribeck curve drives it."""
    run, loop = pushed_pd(float(VELOCITIES[point]), float(LOADS[point]), seconds), loop_of("PD", point)
    for beyond in (0.97, 1.03):
        factor = factor_at(getattr(margins_at("PD", point), side), side, beyond)
        rate, expected = envelope_rate(run(factor), PERIOD), float(growth(with_gain(loop, factor)))
        assert (rate > 0.0) == (beyond > 1.0)
        np.testing.assert_allclose(rate, expected, rtol=0.05)


@pytest.mark.parametrize(
    ("name", "point", "side", "seconds"),
    [
        ("PD+FC+LS", 0, "gain_up", 0.3),
        ("PD+FC+LS", 4, "gain_up", 0.03),
        ("PD+FC+LS", 4, "gain_down", 1.0),
    ],
)
def test_an_observer_s_loop_is_lost_in_simulation_just_beyond_its_gain_margin(name, point, side, seconds):
    """The observer is told the force that was asked for, and not that another one acts."""
    run = simulated(name, steps=10_000).pushed
    for beyond in (0.95, 1.05):
        factor = factor_at(getattr(margins_at(name, point), side), side, beyond)
        pushed, still = (run(VELOCITIES[point], LOADS[point], factor, kick) for kick in (1e-3, 0.0))
        rate = envelope_rate((pushed - still)[: round(seconds / PERIOD)], PERIOD)
        expected = float(growth(with_gain(loop_of(name, point), factor)))
        assert (rate > 0.0) == (beyond > 1.0)
        if beyond > 1.0:  # the mode that grows is the one that is seen; within the margin a slower one may lead
            np.testing.assert_allclose(rate, expected, rtol=0.15)


WHERE = {
    "PD": lambda c: (c.tracking.gains.kp, c.tracking.gains.kd),
    "PD+FC+LS": lambda c: (
        *(c.tracking.gains.kp, c.tracking.gains.kd),
        *(c.observer.tuning.position, c.observer.tuning.velocity, c.observer.tuning.bristle),
        *(c.observer.tuning.load, c.observer.tuning.measurement),
    ),
}


@cache
def by_gains(name):
    """Margins [6] as a function of the gains' logarithms [k] relative to the given ones."""
    drive, controller, where = drive_with(ONE_SAMPLE), smooth_controller(name), WHERE[name]

    def found(logarithms, velocity, load):
        gains = tuple(gain * jnp.exp(by) for gain, by in zip(where(controller), logarithms, strict=True))
        there = eqx.tree_at(where, controller, gains)
        return jnp.stack(margins(open_loop(drive, there, Sampling(), OperatingPoint(velocity, load))))

    return found, jnp.zeros(len(where(controller)))


def everywhere(function):
    """At 0.3 mm/s without load and at 10 mm/s under 10 kN."""
    return np.asarray(jax.jit(jax.vmap(function))(np.array([3e-4, 1e-2]), np.array([0.0, 1e4])))


def test_derivatives_of_the_margins():
    """By the gains and by Q and R, within 1e-5 of differences of fourth order."""
    found, here = by_gains("PD+FC+LS")
    step = 2e-3
    points = step * np.concatenate([sign * np.eye(len(here)) for sign in (1.0, -1.0, 2.0, -2.0)])
    ends = everywhere(lambda v, w: jax.vmap(lambda y: found(y, v, w))(points)).reshape(2, 4, len(here), -1)
    assert np.all(np.isfinite(ends))
    central = ((8 * (ends[:, 0] - ends[:, 1]) - (ends[:, 2] - ends[:, 3])) / (12 * step)).swapaxes(1, 2)
    forward = everywhere(lambda v, w: jax.jacfwd(found)(here, v, w))
    assert np.max(np.abs(forward - central) / np.max(np.abs(central), axis=2, keepdims=True)) < 1e-5


def test_derivatives_in_reverse_mode():
    found, here = by_gains("PD")
    reverse, forward = (everywhere(lambda v, w, jac=jac: jac(found)(here, v, w)) for jac in (jax.jacrev, jax.jacfwd))
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9)


def static_loop(value):
    """A delay of a sample and a lag, times `value`: stable, and below one everywhere for a small value."""
    return OpenLoop(jnp.array([[0.5, 1.0], [0.0, 0.0]]), jnp.array([0.0, 1.0]), -value * jnp.array([0.3, 0.2]), PERIOD)


def test_margins_that_are_not_there_are_infinite():
    """Without crossings, and without any loop: no derivative is NaN, and those of infinite margins are zero."""

    def found(value):
        return jnp.stack(margins(static_loop(value)))

    both_ways = jax.jit(lambda value: (found(value), jax.jacfwd(found)(value), jax.jacrev(found)(value)))
    for value in (0.0, 1e-3):
        values, forward, reverse = both_ways(value)
        assert np.isinf(values[2:4]).all()
        assert values[5] == 0.0
        assert np.all(np.isfinite(forward))
        assert forward[2] == forward[3] == forward[5] == 0.0
        np.testing.assert_allclose(reverse, forward, rtol=1e-12)


def test_an_unstable_loop_is_called_so():
    """The paper's PD with a hundred times its gains, and any loop at standstill: a bristle is neutral there."""
    loop = loop_of("PD", 4)
    assert margins_at("PD", 4).growth < 0.0
    assert growth(with_gain(loop, 100.0)) > 100.0 * NEUTRAL_GROWTH
    assert abs(growth(loop_of("PD+FC+LS", 0))) < 1e-3 * NEUTRAL_GROWTH


def test_an_oscillation_that_leads_has_its_derivative():
    """d|z| of a complex pair, however far it is from a rotation in these coordinates."""
    turn = jnp.array([[0.9, 5.0], [-0.01, 0.95]])

    def rate(gain):
        return growth(OpenLoop(turn, jnp.array([0.0, 1.0]), gain * jnp.array([0.05, 0.0]), PERIOD))

    expected = [0.5 * np.log(0.9 * 0.95 + 5.0 * 0.01 - gain * 5.0 * 0.05) / PERIOD for gain in (-1e-6, 1e-6)]
    np.testing.assert_allclose(rate(0.0), np.mean(expected), rtol=1e-9)
    np.testing.assert_allclose(jax.grad(rate)(0.0), (expected[1] - expected[0]) / 2e-6, rtol=1e-6)
    np.testing.assert_allclose(jax.jacfwd(rate)(0.0), jax.grad(rate)(0.0), rtol=1e-12)


def test_a_gain_margin_at_half_the_control_rate():
    """A light, damped table sampled slowly: its loop ends on the real axis, and is lost by flipping each sample."""
    drive = as_arrays(Drive(Plant(0.5, (380.0, 260.0)), PAPER.friction))
    controller = as_arrays(PD(Tracking(PDGains(2e5, 2e3))))
    found = jax.jit(lambda v: open_loop(drive, controller, Sampling(1000.0, 32), OperatingPoint(v, 0.0)))(0.01)
    loop = jax.tree.map(np.asarray, found)
    up, _ = gains_that_hold(loop)
    assert up < 2.0
    np.testing.assert_allclose(jax.jit(margins)(loop).gain_up, up, rtol=1e-5)
    modes = np.linalg.eigvals(with_gain(loop, up).closed_loop)
    np.testing.assert_allclose(modes[np.argmax(np.abs(modes))], -1.0, rtol=1e-5)


def test_peak_sensitivity_is_that_of_a_fine_grid():
    for name, point in (("PD", 1), ("PD+FC+LS", 4)):
        loop, found = loop_of(name, point), margins_at(name, point)
        peak = 1.0 / np.min(np.abs(1.0 + np.asarray(response(loop, np.geomspace(10.0, 300.0, 200_001)).loop)))
        np.testing.assert_allclose(found.sensitivity, peak, rtol=1e-8)
