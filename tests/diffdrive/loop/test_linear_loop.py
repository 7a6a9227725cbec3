"""The loop of an axis in the units of its user: the pure functions beneath, in decibels, degrees and hertz."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.controllers import Cascade
from diffdrive.errors import ParameterError
from diffdrive.loop.linearise import OpenLoop, OperatingPoint, open_loop, response
from diffdrive.loop.margins import margins
from diffdrive.numerics.arrays import as_arrays

AXIS = dd.paper_axis(controller="pd")
AXIS = AXIS.replace({"plant.mass": 110.0}).with_drive(
    dataclasses.replace(AXIS.drive, actuator=dataclasses.replace(AXIS.drive.actuator, delay_samples=1))
)


@pytest.mark.long
def test_a_linear_loop_is_the_open_loop_of_the_smooth_axis():
    smooth = AXIS.smooth()
    theirs = jax.jit(
        lambda v, w: open_loop(*as_arrays((smooth.drive, smooth.controller)), AXIS.sampling, OperatingPoint(v, w))
    )(0.010, 4_000.0)
    ours = dd.linearise(AXIS, velocity=0.010, load=4_000.0)
    np.testing.assert_allclose(ours.open_loop.closed_loop, theirs.closed_loop, rtol=1e-12, atol=1e-15)
    frequencies = np.geomspace(1.0, 5_000.0, 50)
    np.testing.assert_allclose(ours.response(frequencies), response(theirs, frequencies).loop, rtol=1e-9)
    found, factors = ours.margins(), margins(theirs)
    assert float(found.gain_margin_up) == pytest.approx(20.0 * np.log10(factors.gain_up), rel=1e-9)
    assert float(found.phase_margin) == pytest.approx(np.degrees(factors.phase), rel=1e-9)
    assert float(found.peak_sensitivity) == pytest.approx(float(factors.sensitivity), rel=1e-9)
    assert float(found.crossover) == pytest.approx(float(factors.crossover), rel=1e-9)


def test_the_margins_are_what_their_units_say():
    loop = dd.linearise(AXIS, velocity=0.010)
    found = loop.margins()
    assert bool(found.stable)
    at = complex(loop.response([float(found.crossover)])[0])
    assert abs(at) == pytest.approx(1.0, rel=1e-6)
    assert 180.0 - abs(np.degrees(np.angle(at))) == pytest.approx(float(found.phase_margin), rel=1e-6)
    # as an amplifier whose gain is off by as much: the controller's gains are all that scale the loop of PD
    for share, stable in ((0.98, True), (1.02, False)):
        factor = 10.0 ** (share * float(found.gain_margin_up) / 20.0)
        louder = AXIS.with_gains(**{name: factor * gain for name, gain in AXIS.gains.items()})
        assert bool(dd.linearise(louder, velocity=0.010).margins().stable) is stable
    assert float(found.gain_margin) == min(float(found.gain_margin_up), float(found.gain_margin_down))
    assert repr(found).startswith("stable; gain margins ")
    assert "deg at" in repr(found)


@pytest.mark.long
def test_lanes_and_gradients_go_through():
    def phase_margin(kd, velocity):
        return dd.linearise(AXIS.with_gains(kd=kd), velocity=velocity).margins().phase_margin

    kd, speeds = AXIS.gains["kd"], jnp.array([0.003, 0.010])
    lanes = jax.jit(jax.vmap(phase_margin, (None, 0)))(kd, speeds)
    np.testing.assert_allclose(lanes, [phase_margin(kd, float(speed)) for speed in speeds], rtol=1e-9)
    step = 1e-4 * kd
    difference = (phase_margin(kd + step, 0.010) - phase_margin(kd - step, 0.010)) / (2.0 * step)
    assert float(jax.grad(phase_margin)(kd, 0.010)) == pytest.approx(float(difference), rel=1e-4)


@pytest.mark.long
def test_a_loop_of_each_lane_has_its_own_margins_and_response():
    one = OpenLoop(jnp.array([[0.9, 0.01], [0.0, 0.8]]), jnp.array([0.0, 0.02]), jnp.array([-60.0, -5.0]), 1e-3)
    many = jax.vmap(lambda gain: dd.LinearLoop(dataclasses.replace(one, c=gain * one.c), 0.010, 0.0))(
        jnp.ones(3).at[1].set(0.5)
    )
    frequencies = jnp.array([1.0, 30.0, 200.0])
    found, alone = many.margins(), dd.LinearLoop(one, 0.010, 0.0).margins()
    expected = alone.gain_margin_up + np.array([0.0, 20.0 * np.log10(2.0), 0.0])
    np.testing.assert_allclose(found.gain_margin_up, expected, rtol=1e-6)
    theirs = response(one, frequencies).loop
    np.testing.assert_allclose(many.response(frequencies), [theirs, 0.5 * theirs, theirs], rtol=1e-12)
    assert repr(many).startswith("LinearLoop of 2 states")


def test_a_machine_of_its_own_is_in_the_loop():
    heavy = AXIS.replace({"plant.mass": 200.0})
    frequencies = np.array([50.0, 200.0])
    ours = dd.linearise(AXIS, velocity=0.010, machine=heavy).response(frequencies)
    own = dd.linearise(AXIS, velocity=0.010).response(frequencies)
    assert np.all(np.abs(ours) < 0.7 * np.abs(own))


@pytest.mark.long
def test_a_force_limit_far_away_leaves_the_loop_of_a_cascade_as_it_is():
    """Without speed feed-forward its steady motion has a following error; without that its integral would saturate."""
    cascade = AXIS.with_controller(Cascade(kp=50.0, kv=2e4, ki=1e6))
    frequencies = np.geomspace(1.0, 4_000.0, 20)
    free, limited = (
        dd.linearise(axis, velocity=0.020).response(frequencies)
        for axis in (cascade, cascade.replace({"actuator.force_limit": 2_000.0}))
    )
    np.testing.assert_allclose(limited, free, rtol=1e-9)


@pytest.mark.parametrize(
    ("asked", "says"),
    [
        ({"velocity": float("nan")}, r"velocity: must be a finite number in m/s, got nan"),
        ({"velocity": 0.01, "load": -1.0}, r"load: must be a finite number in N, 0 or more, got -1"),
        ({"velocity": np.array([0.01, 0.02])}, r"velocity: must be one number; take `jax\.vmap`"),
    ],
)
def test_what_is_no_steady_motion_is_refused(asked, says):
    with pytest.raises(ParameterError, match=says):
        dd.linearise(AXIS, **asked)


@pytest.mark.parametrize("frequency", [0.0, -1.0, 5_001.0, float("nan")])
def test_a_frequency_that_a_sampled_loop_does_not_have_is_refused(frequency):
    with pytest.raises(ParameterError, match="up to 5000 Hz, half the rate"):
        dd.linearise(AXIS, velocity=0.010).response([10.0, frequency])
