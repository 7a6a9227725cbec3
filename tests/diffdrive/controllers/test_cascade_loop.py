"""The linearised loop of a cascade with what real loops have, against python-control and differences."""

import dataclasses

import control
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm

import diffdrive as dd
from diffdrive.controllers import PT1, PT2, Cascade, Notch, SecondOrder
from diffdrive.loop.linearise import OperatingPoint, open_loop
from diffdrive.loop.linearise import response as loop_response
from diffdrive.loop.margins import margins
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.friction import stribeck_level
from diffdrive.model.parameters import Actuator, Sampling
from diffdrive.numerics.arrays import as_arrays
from tests.diffdrive.controllers.test_filters import by_python_control
from tests.support.cascades import IDEAL, MOVE, PERIOD, RATE

LINEAR = Cascade(
    kp=90.0, kv=3e4, velocity_samples=2, reset_time=0.02, force_limit=5_000.0, velocity_filter_time=3e-4,
    reference_filter_time=2e-3, reference_delay_samples=3, position_every=4,
    filters=(Notch(700.0, 200.0, 25.0), PT2(1_500.0), SecondOrder(1_100.0, 0.1, 900.0, 0.5)),
)  # fmt: skip
LATE = Actuator(force_limit=3_000.0, delay_samples=1, delay_fraction=0.4)


def table_by_hand(velocity):
    """The paper's table about a steady motion, [x, v, z]: of its friction see `drive_by_hand` in test_linearise.py."""
    friction = IDEAL.friction
    level = float(stribeck_level(friction, velocity, 0.0))
    gap, slowest = friction.breakaway_gap.positive, friction.stribeck_velocity.positive
    slope = -gap / slowest * np.exp(-velocity / slowest)
    bristle = np.array([0.0, velocity * slope / level, -3.35e7 * velocity / level])
    drag = friction.viscous.positive + IDEAL.plant.damping.positive
    pull = -(np.array([0.0, drag, 3.35e7]) + 4.54e3 * bristle) / 100.0
    return np.array([[0.0, 1.0, 0.0], pull, bristle]), np.array([0.0, 0.01, 0.0])


def current_loop_by_hand(actuator):
    """From request to force, (a, b, c) in continuous time."""
    w, damping = 2 * np.pi * actuator.current_loop_frequency, actuator.current_loop_damping
    if damping is None:
        return np.array([[-w]]), np.array([w]), np.array([1.0])
    return np.array([[0.0, 1.0], [-(w**2), -2 * damping * w]]), np.array([0.0, w**2]), np.array([1.0, 0.0])


def switched(a, b, c, share, z):
    """c x at the end of each period, of requests that arrive a share of it late; by matrix exponentials."""
    n = len(b)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = a, b
    late, rest = expm(whole * share * PERIOD), expm(whole * (1.0 - share) * PERIOD)
    ahead, before, now = rest[:n, :n] @ late[:n, :n], rest[:n, :n] @ late[:n, n], rest[:n, n]
    return np.array([c @ np.linalg.solve(one * np.eye(n) - ahead, before / one + now) for one in z])


def machine_by_hand(actuator, velocity, z, *, mean):
    """From request to position, per period; the force held at its mean over each period, or as it is within it."""
    share = actuator.delay_fraction or 0.0
    table, push = table_by_hand(velocity)
    if actuator.current_loop_frequency is None:
        if not mean:
            return switched(table, push, np.eye(3)[0], share, z)
        force = share / z + (1.0 - share)
    else:
        a, b, c = current_loop_by_hand(actuator)
        n = len(b)
        if not mean:
            both = np.block([[table, np.outer(push, c)], [np.zeros((n, 3)), a]])
            return switched(both, np.r_[np.zeros(3), b], np.eye(3 + n)[0], share, z)
        # of its integral the increase over a period, per period
        with_integral = np.block([[a, np.zeros((n, 1))], [c[None], np.zeros((1, 1))]])
        force = switched(with_integral, np.r_[b, 0.0], np.eye(n + 1)[n], share, z) * (z - 1.0) / PERIOD
    return switched(table, push, np.eye(3)[0], 0.0, z) * force


def law_by_hand(c, z):
    """From position to force command, by python-control where there are filters."""
    speed = (1.0 - z**-c.velocity_samples) * RATE / c.velocity_samples
    speed = speed * by_python_control(PT1(c.velocity_filter_time))(z)
    hold = sum(z**-k for k in range(c.position_every)) / c.position_every
    pi = c.kv * (1.0 + PERIOD / c.reset_time * z / (z - 1.0))
    for one in c.filters:
        pi = pi * by_python_control(one)(z)
    return (c.kp * hold + speed) * pi


@pytest.mark.long
@pytest.mark.parametrize(
    "actuator",
    [
        LATE,
        dataclasses.replace(LATE, current_loop_frequency=900.0),
        dataclasses.replace(LATE, current_loop_frequency=1_200.0, current_loop_damping=0.7),
    ],
    ids=["delay", "current loop of first order", "of second order"],
)
def test_margins_and_response_with_filters_are_those_of_python_control(actuator):
    axis = dd.Axis(dataclasses.replace(IDEAL, actuator=actuator), LINEAR, Sampling(RATE, 32))
    loop = dd.linearise(axis, velocity=0.01)
    frequency = np.geomspace(2.0, 3_900.0, 4_000)
    z = np.exp(2j * np.pi * frequency * PERIOD)
    around = law_by_hand(LINEAR, z) * z**-actuator.delay_samples
    expected = around * machine_by_hand(actuator, 0.01, z, mean=True)
    got = np.asarray(loop.response(frequency))
    np.testing.assert_allclose(got[frequency < 2_000.0], expected[frequency < 2_000.0], rtol=1e-3)
    # what the mean leaves out of a force that changes within a period
    exact = around * machine_by_hand(actuator, 0.01, z, mean=False)
    bound = 1e-3 + (2 * np.pi * frequency / RATE) ** 2 / 8.0
    assert np.all((np.abs(got / exact - 1.0) < bound)[frequency < 1_000.0])
    gain, phase, distance, *_ = control.stability_margins(
        control.FRD(expected, 2 * np.pi * frequency, smooth=True), returnall=True
    )
    found = loop.margins()
    assert bool(found.stable)
    assert float(found.gain_margin_up) == pytest.approx(20.0 * np.log10(np.min(gain[gain > 1.0])), rel=1e-3)
    assert float(found.phase_margin) == pytest.approx(np.min(np.abs(phase)), rel=1e-3)
    assert float(found.peak_sensitivity) == pytest.approx(1.0 / np.min(distance), rel=1e-3)


@pytest.mark.long
def test_a_set_point_s_filter_is_not_in_the_loop():
    drive, sampling = as_arrays(smooth(IDEAL)), Sampling(RATE)
    plain = Cascade(90.0, 3e4, reset_time=0.02)
    loops = [
        open_loop(drive, as_arrays(smooth(c)), sampling, OperatingPoint(0.01, 0.0))
        for c in (plain, dataclasses.replace(plain, reference_filter_time=5e-3, reference_delay_samples=7))
    ]
    assert loops[0].a.shape == loops[1].a.shape
    np.testing.assert_allclose(loops[1].closed_loop, loops[0].closed_loop, rtol=1e-9, atol=1e-12)


@pytest.mark.long
def test_derivatives_of_margin_and_error_by_every_gain_and_filter_are_those_of_differences():
    axis = dd.Axis(smooth(IDEAL), smooth(LINEAR), Sampling(RATE, 2))
    gains = {name: jnp.asarray(value) for name, value in axis.gains.items()}
    inputs = loop_inputs(MOVE, np.zeros(len(MOVE.time)))

    @jax.jit
    def worth(gains):
        controller = as_arrays(axis.with_gains(**gains).controller)
        drive = as_arrays(axis.drive)
        loop = open_loop(drive, controller, axis.sampling, OperatingPoint(0.01, 0.0))
        frames = rollout_loop(drive, controller, inputs, axis.sampling)
        error = 1e6 * jnp.sqrt(jnp.mean((inputs.reference.position - frames.table_position) ** 2))
        return jnp.array([margins(loop).phase, jnp.abs(loop_response(loop, jnp.array([300.0])).loop[0]), error])

    slopes = jax.jit(jax.jacfwd(worth))(gains)
    sizes = np.max([np.abs(slope * gains[name]) for name, slope in slopes.items()], axis=0)
    for name, value in gains.items():
        up, down = (np.asarray(worth(gains | {name: factor * value})) for factor in (1.0 + 1e-5, 1.0 - 1e-5))
        np.testing.assert_allclose(slopes[name] * value, (up - down) / 2e-5, rtol=1e-5, atol=1e-5 * np.max(sizes))
