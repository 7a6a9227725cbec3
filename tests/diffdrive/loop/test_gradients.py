"""Derivatives of the tracking error by every continuous parameter, against differences, and where they could break."""

from functools import cache

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

from diffdrive import motion
from diffdrive.controllers import (
    DOBVSC,
    PD,
    Cascade,
    DisturbanceObserver,
    Feedforward,
    FrictionCompensation,
    PDFeedforwardDOB,
)
from diffdrive.controllers.base import paper_tracking
from diffdrive.loop import metrics
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Drive, Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion import load
from diffdrive.numerics.arrays import as_arrays
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, LoadStateTuning, Tuning
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad

PAPER = paper_drive(quantised=False)
PLANT = eqx.tree_at(lambda plant: plant.constant_force, PAPER.plant, 5.0)
DRIVE = Drive(PLANT, PAPER.friction, Actuator(), Sensor(noise=1e-8))
LATE = Actuator(force_limit=98.0, delay_samples=1, delay_fraction=0.3)
LIMITED = eqx.tree_at(lambda drive: drive.actuator, DRIVE, LATE)
# the controllers' models are off by a few per cent, as on a real machine, so that no derivative vanishes by symmetry
MODEL = jax.tree.map(lambda value: 1.03 * value, Drive(PLANT, PAPER.friction))
TRACKING = paper_tracking(MODEL, PAPER_KP, PAPER_KD)
LIMITED_PD = "PD at its force limit"
CONTROLLERS = {
    "PD": PD(TRACKING),
    LIMITED_PD: PD(TRACKING),
    "DOBVSC": DOBVSC(TRACKING, DisturbanceObserver.of(MODEL.plant, 100.0)),
    "PD+FF+DOB": PDFeedforwardDOB(TRACKING, DisturbanceObserver.of(MODEL.plant, 5.0), MODEL.friction, 500.0),
    "PD+FC": FrictionCompensation(TRACKING, KalmanObserver(MODEL.plant, MODEL.friction, Tuning(), FixedLoad(300.0))),
    "PD+FC+LE": FrictionCompensation(
        TRACKING,
        KalmanObserver(MODEL.plant, MODEL.friction, Tuning(), InnovationLoad(initial_load=300.0)),
    ),
    "PD+FC+LS": FrictionCompensation(
        TRACKING, LoadStateObserver(MODEL.plant, MODEL.friction, LoadStateTuning(), 300.0)
    ),
    "cascade": Cascade(100.0, 2e4, 1e6, 0.9, Feedforward.of(MODEL.plant), 2),
}
# parts of others in the list, or not of the paper: with the long studies
PARTS = ("PD", "PD+FC", "PD+FF+DOB", "PD+FC+LS")
SAMPLES = 1801
DURATION = (SAMPLES - 1) * 1e-4


def reversing(speed=0.01):
    """Up to 10 mm/s, a reversal and back, the load growing to 8 kN."""
    there = motion.triangular(speed=speed, stroke=0.07 * speed, rounding=0.04, duration=DURATION, rate=1e4)
    return loop_inputs(there, load.ramp(there.time, start=0.03, end=0.12, to=8e3))


def resting():
    return jax.tree.map(jnp.zeros_like, reversing())


def of_parameters(drive, controller):
    """RMS tracking error as a function of the logarithms of all parameters relative to `values`, and these."""
    values, restore = ravel_pytree(as_arrays((drive, controller)))

    def error(logarithms, values, inputs):
        drive, controller = restore(values * jnp.exp(logarithms))
        frames = rollout_loop(drive, controller, inputs, Sampling(substeps=2), jax.random.key(0))
        return metrics.rms(inputs.reference.position - frames.table_position)

    return error, values


def smooth_parts(name):
    return smooth((LIMITED if name == LIMITED_PD else DRIVE, CONTROLLERS[name]))


@cache
def smooth_loop(name):
    return of_parameters(*smooth_parts(name))


@cache
def exact_loop(name):
    scale = Sensor(resolution=1e-7, noise=1e-8)
    return of_parameters(Drive(PLANT, PAPER.friction, LIMITED.actuator, scale), CONTROLLERS[name])


@cache
def differentiated(name):
    """Value, reverse and forward derivative of the smooth loop, compiled once for all motions."""
    error, _ = smooth_loop(name)

    def both(values, inputs):
        here = jnp.zeros_like(values)
        return *jax.value_and_grad(error)(here, values, inputs), jax.jacfwd(error)(here, values, inputs)

    return jax.jit(both)


@cache
def exactly_differentiated(name):
    """Value, reverse derivative and forward derivative along all parameters together, of the exact loop."""
    error, _ = exact_loop(name)

    def both(values, inputs):
        here = jnp.zeros_like(values)
        _, along = jax.jvp(lambda at: error(at, values, inputs), (here,), (jnp.ones_like(here),))
        return *jax.value_and_grad(error)(here, values, inputs), along

    return jax.jit(both)


def by_differences(name):
    """Central differences of fourth order, each at the step where it changes least with the step."""
    error, values = smooth_loop(name)
    steps = 10.0 ** -np.arange(2.0, 6.5, 0.5)
    offsets, weights = np.array([1.0, -1.0, 2.0, -2.0]), np.array([8, -8, -1, 1]) / 12
    every = steps[:, None] * offsets
    points = every.reshape(-1, 1, 1) * jnp.eye(len(values))
    lanes = jax.vmap(error, in_axes=(0, None, None))
    errors = jax.jit(lambda p, v, i: jax.lax.map(lambda row: lanes(row, v, i), p))(points, values, reversing())
    slopes = np.einsum("sop,o->sp", np.asarray(errors).reshape(*every.shape, -1), weights) / steps[:, None]
    steadiest = np.abs(np.diff(slopes, axis=0)).argmin(0)
    return slopes[steadiest + 1, np.arange(len(values))]


def _marks(name):
    """One is enough for every run, a PD at its limit."""
    quick = name == "PD at its force limit"
    return [pytest.mark.slow] if name in PARTS else [] if quick else [pytest.mark.long]


@pytest.mark.parametrize("name", [pytest.param(one, marks=_marks(one)) for one in CONTROLLERS])
def test_derivatives_by_every_parameter(name):
    _, values = smooth_loop(name)
    assert np.all(values > 0)
    rms, reverse, forward = differentiated(name)(values, reversing())
    # a relative 1e-5 of each; below 1e-5 of the error itself differences in double precision no longer resolve that
    least = 1e-5 * float(rms)
    assert np.all(np.abs(forward) > 0.1 * least), "every parameter should matter"
    scale = np.maximum(np.abs(forward), least)
    assert (np.abs(by_differences(name) - forward) / scale).max() < 1e-5
    assert (np.abs(reverse - forward) / scale).max() < 1e-9


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [pytest.param(one, marks=[pytest.mark.slow] * (one == "PD+FC")) for one in CONTROLLERS]
)
def test_derivatives_at_rest_are_zero(name):
    paths = [jax.tree_util.keystr(path) for path, _ in jax.tree_util.tree_leaves_with_path(smooth_parts(name))]
    moves = ["constant_force" in path or "noise" in path for path in paths]
    _, values = smooth_loop(name)
    rms, reverse, forward = differentiated(name)(jnp.where(np.array(moves), 0.0, values), resting())
    # a rounded force limit returns 1e-14 N for a command of zero
    np.testing.assert_allclose(rms, 0.0, atol=1e-20)
    np.testing.assert_allclose(reverse, 0.0, atol=1e-18)
    np.testing.assert_allclose(forward, 0.0, atol=1e-18)


@pytest.mark.long
@pytest.mark.parametrize("name", CONTROLLERS)
def test_derivatives_in_stick_are_finite_and_agree(name):
    """A table pushed by a constant force that its friction holds."""
    _, values = smooth_loop(name)
    rms, reverse, forward = differentiated(name)(values, resting())
    assert 0 < rms < 1e-6
    assert np.any(forward != 0)
    np.testing.assert_allclose(reverse, forward, rtol=1e-8, atol=1e-9 * np.abs(forward).max())


@pytest.mark.long
@pytest.mark.parametrize(
    "name", [LIMITED_PD, *(pytest.param(one, marks=pytest.mark.slow) for one in ("PD+FC+LE", "PD+FC+LS"))]
)
@pytest.mark.parametrize("inputs", [reversing(), reversing(0.2), resting()], ids=["10 mm/s", "200 mm/s", "rest"])
def test_derivatives_of_the_exact_machine_are_finite(name, inputs):
    """Quantised, noisy, delayed, its hard force limit reached, its estimator switched on and off."""
    _, values = exact_loop(name)
    rms, reverse, along = exactly_differentiated(name)(values, inputs)
    assert np.isfinite(rms)
    assert np.all(np.isfinite(reverse))
    np.testing.assert_allclose(along, reverse.sum(), rtol=1e-7, atol=1e-9 * np.abs(reverse).max())


def test_a_quantised_loop_has_the_derivative_of_the_smooth_one():
    """The straight-through rule keeps the feedback in the derivative."""
    slopes = []
    for resolution in (1e-7, None):
        drive = Drive(PLANT, PAPER.friction, Actuator(), Sensor(resolution, 1e-8))
        error, values = of_parameters(drive, CONTROLLERS["PD"])
        slopes.append(np.asarray(jax.jit(jax.jacfwd(error))(jnp.zeros_like(values), values, reversing())))
        slopes[-1] = slopes[-1][np.asarray(values) != 1e-7]
    np.testing.assert_allclose(*slopes, rtol=0.01, atol=1e-3 * np.abs(slopes[1]).max())


def test_the_force_limit_is_reached():
    for drive in (LIMITED, smooth(LIMITED)):
        frames = rollout_loop(*as_arrays((drive, CONTROLLERS[LIMITED_PD])), reversing(), Sampling(substeps=2))
        assert np.mean(np.abs(frames.force) > 97.0) > 0.05
        assert np.mean(np.abs(frames.command) > 110.0) > 0.05


@cache
def by_the_gain(kept, every):
    """The tracking error and its slope by kp, reverse mode keeping the state of each `kept`-th step; compiled."""
    drive, controller = as_arrays(smooth((DRIVE, CONTROLLERS["PD+FC+LE"])))
    inputs = reversing()

    def cost(kp):
        tuned = eqx.tree_at(lambda c: c.tracking.gains.kp, controller, kp)
        frames = rollout_loop(
            drive, tuned, inputs, Sampling(substeps=1), jax.random.key(0), every, checkpoint_every=kept
        )
        wanted = inputs.reference.position[: len(frames.table_position) * every : every]
        return metrics.rms(wanted - frames.table_position)

    return jax.jit(jax.value_and_grad(cost)).lower(jnp.asarray(PAPER_KP)).compile()


@pytest.mark.long
@pytest.mark.parametrize(("kept", "every"), [(2, 1), (2, 4)])
def test_how_many_steps_reverse_mode_keeps_changes_no_gradient(kept, every):
    """A remainder in both: 1801 steps in pairs, and the 3 between two recorded ones."""
    at = jnp.asarray(PAPER_KP)
    np.testing.assert_allclose(by_the_gain(kept, every)(at), by_the_gain(1, every)(at), rtol=1e-9)


@pytest.mark.long
def test_every_second_step_kept_takes_half_the_memory():
    memory = [by_the_gain(kept, 1).memory_analysis().temp_size_in_bytes / SAMPLES * 50_000 for kept in (1, 2)]
    assert memory[1] < 0.65 * memory[0]
    assert memory[1] < 6e6  # bytes of 50,000 steps
