"""Actuator and sensor against their formulas, recomputed in NumPy from what a run recorded."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from diffdrive import motion as motions
from diffdrive.controllers import PD
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import ParameterError
from diffdrive.loop.run import Run
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model import actuator, current_loop, sensor
from diffdrive.model.parameters import Actuator, Sensor, check_drive
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive

IDEAL = paper_drive(quantised=False)
ROUGH = dataclasses.replace(IDEAL, sensor=Sensor(resolution=1e-7, noise=2e-8))
PAPER_PD = PD(paper_tracking(IDEAL, PAPER_KP, PAPER_KD))
MOVE = motions.jerk_limited(distance=2e-3, speed=0.01, acceleration=1.0, jerk=100.0, rate=10_000.0, dwell=0.02)
N = len(MOVE.time)


def run_of(drive=IDEAL, **options) -> Run:
    return simulate_loop(drive, PAPER_PD, MOVE, **options).require_ok()


# --- actuator ---------------------------------------------------------------------------------------------------------


def acting(parts: Actuator, commands: np.ndarray) -> np.ndarray:
    """The forces that act for these commands."""

    def body(state, command):
        state = actuator.step(parts, state, command, 1e-4)
        return state, state.applied

    return np.asarray(jax.lax.scan(body, actuator.init(parts), jnp.asarray(commands))[1])


@pytest.mark.parametrize("delay", [0, 1, 4])
def test_a_delay_shifts_the_force_by_whole_samples(delay):
    commands = np.random.default_rng(1).normal(size=50)
    np.testing.assert_array_equal(
        acting(Actuator(delay_samples=delay), commands), np.r_[np.zeros(delay), commands][:50]
    )


@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("fraction", [0.0, 0.3, 1.0])
def test_a_delay_of_a_fraction_passes_the_momentum_of_the_force_that_switches_within_the_period(delay, fraction):
    commands = np.random.default_rng(1).normal(size=50)
    fine = np.repeat(np.r_[np.zeros(delay + 1), commands], 10)  # ten parts of a period
    switched = fine[10 - round(10 * fraction) :][: 10 * 50].reshape(50, 10).mean(axis=1)
    forces = acting(Actuator(delay_samples=delay, delay_fraction=fraction), commands)
    np.testing.assert_allclose(forces, switched, rtol=0, atol=1e-14)


def integrated(fine: np.ndarray, frequency: float, damping: float | None, parts: int) -> np.ndarray:
    """Mean force in each period of 0.1 ms under a request that is constant in each part of one; by matrix exponentials.

    Of the system that has the integral of the force as a state of its own.
    """
    w = 2 * np.pi * frequency
    if damping is None:
        a, b = np.array([[-w, 0.0], [1.0, 0.0]]), np.array([w, 0.0])
    else:
        a = np.array([[0.0, 1.0, 0.0], [-(w**2), -2 * damping * w, 0.0], [1.0, 0.0, 0.0]])
        b = np.array([0.0, w**2, 0.0])
    n = len(b)
    ahead = expm(np.block([[a, b[:, None]], [np.zeros((1, n + 1))]]) * 1e-4 / parts)
    x, impulse = np.zeros(n), [0.0]
    for request in fine:
        x = ahead[:n, :n] @ x + ahead[:n, n] * request
        impulse.append(x[-1])
    return np.diff(impulse[::parts]) / 1e-4


@pytest.mark.parametrize("damping", [None, 0.3, 0.7, 0.999])
@pytest.mark.parametrize("frequency", [20.0, 800.0, 4e4])
@pytest.mark.parametrize(("delay", "fraction"), [(0, None), (2, 0.3)])
def test_a_current_loop_passes_the_momentum_of_its_differential_equation(frequency, damping, delay, fraction):
    commands = np.random.default_rng(1).normal(size=40)
    late = round(10 * (fraction or 0.0))
    requests = np.r_[np.zeros(10 * delay + late), np.repeat(commands, 10)][:400]  # ten parts of a period
    parts = Actuator(
        delay_samples=delay, delay_fraction=fraction, current_loop_frequency=frequency, current_loop_damping=damping
    )
    expected = integrated(requests, frequency, damping, 10)
    np.testing.assert_allclose(acting(parts, commands), expected, rtol=0, atol=1e-11)


@pytest.mark.parametrize("damping", [None, 0.6])
def test_the_derivatives_of_a_current_loop_are_those_of_differences(damping):
    commands = np.random.default_rng(2).normal(size=30)

    def last(frequency, fraction, damping):
        return acting(Actuator(delay_fraction=fraction, current_loop_frequency=frequency,
                               current_loop_damping=damping), commands)[-1]  # fmt: skip

    def traced(frequency, fraction, damping):
        parts = Actuator(delay_fraction=fraction, current_loop_frequency=frequency, current_loop_damping=damping)

        def body(state, command):
            state = actuator.step(parts, state, command, 1e-4)
            return state, state.applied

        return jax.lax.scan(body, actuator.init(parts), jnp.asarray(commands))[1][-1]

    at = (500.0, 0.4) if damping is None else (500.0, 0.4, damping)
    slopes = jax.grad(lambda *values: traced(*(*values, None)[:3]), argnums=tuple(range(len(at))))(*at)
    for k, (value, slope) in enumerate(zip(at, slopes, strict=True)):
        step = 1e-5 * value
        ends = [last(*(*(v + sign * step * (j == k) for j, v in enumerate(at)), None)[:3]) for sign in (1, -1)]
        assert float(slope) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-5)


@pytest.mark.parametrize("damping", [None, 0.5])
def test_the_mean_forces_of_a_log_are_those_of_the_steps(damping):
    """From a long time at the first command on, as what was before a log is not known."""
    commands = np.r_[70.0, np.random.default_rng(3).normal(size=30)]
    parts = Actuator(current_loop_frequency=300.0, current_loop_damping=damping)
    state, expected = actuator.steady_state(parts, jnp.asarray(70.0)), []
    for command in commands:
        state = actuator.step(parts, state, jnp.asarray(command), 1e-4)
        expected.append(float(state.applied))
    np.testing.assert_allclose(current_loop.mean_forces(parts, jnp.asarray(commands), 1e-4), expected, atol=1e-11)
    np.testing.assert_array_equal(current_loop.mean_forces(Actuator(), jnp.asarray(commands), 1e-4), commands)


@pytest.mark.parametrize("damping", [None, 0.5])
def test_a_current_loop_at_rest_under_a_force_stays_there(damping):
    parts = Actuator(current_loop_frequency=300.0, current_loop_damping=damping)
    held = actuator.steady_state(parts, jnp.asarray(70.0))
    ahead = actuator.step(parts, held, jnp.asarray(70.0), 1e-4)
    np.testing.assert_allclose(jax.tree.leaves(ahead), jax.tree.leaves(held), rtol=1e-12, atol=1e-9)


def test_a_damping_without_a_current_loop_is_refused():
    drive = dataclasses.replace(IDEAL, actuator=Actuator(current_loop_damping=0.7))
    with pytest.raises(ParameterError, match=r"actuator\.current_loop_damping: give current_loop_frequency, too"):
        check_drive(drive)


@pytest.mark.parametrize("delay", [0, 2])
def test_a_run_s_force_is_its_command_clipped_and_delayed(delay):
    drive = dataclasses.replace(ROUGH, actuator=Actuator(force_limit=100.0, delay_samples=delay))
    run = run_of(drive)
    np.testing.assert_array_equal(run.force, np.clip(np.r_[np.zeros(delay), run.command][:N], -100.0, 100.0))
    assert np.max(np.abs(run.command)) > 100.0


@settings(max_examples=40, deadline=None)
@given(st.floats(10.0, 1e4), st.floats(1e-4, 0.3))
def test_the_smooth_limit_is_within_a_width_of_the_hard_one_and_rises(limit, share):
    width = share * limit
    commands = jnp.linspace(-3 * limit, 3 * limit, 1001)
    rounded = np.asarray(actuator.saturate(Actuator(limit, width), commands))
    hard = np.asarray(actuator.saturate(Actuator(limit), commands))
    np.testing.assert_array_equal(hard, np.clip(commands, -limit, limit))
    assert np.max(np.abs(rounded - hard)) <= width * np.log(2) * (1 + 1e-9)  # softplus(0) = log 2, at the corners
    assert np.max(np.abs(rounded)) <= limit * (1 + 1e-12)
    assert np.all(np.diff(rounded) >= -1e-9 * limit)
    np.testing.assert_allclose(rounded, -rounded[::-1], atol=1e-9 * limit)
    slope = jax.grad(lambda u: actuator.saturate(Actuator(limit, width), u))(limit)
    assert float(slope) == pytest.approx(0.5, abs=1e-2)


# --- sensor -----------------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.floats(-1.0, 1.0), st.floats(1e-9, 1e-3))
def test_a_quantised_position_is_the_nearest_step(position, resolution):
    steps = float(sensor.quantise(position, resolution)) / resolution
    assert steps == pytest.approx(round(steps), abs=1e-6)
    assert abs(steps - position / resolution) <= 0.5 + 1e-6


def test_the_derivative_of_the_quantiser_is_straight_through():
    for position in (0.0, 3.3e-7, -1.25e-3):
        assert float(jax.grad(lambda x: sensor.quantise(x, 1e-7))(position)) == 1.0


def test_a_run_reports_positions_on_the_grid_of_the_scale():
    run = run_of(paper_drive())
    np.testing.assert_allclose(run.position / 1e-7, np.round(run.position / 1e-7), atol=1e-6)
    assert np.max(np.abs(run.position - run.table_position)) <= 0.5e-7 * (1 + 1e-6)


def test_without_resolution_and_noise_the_scale_tells_the_truth():
    run = run_of()
    np.testing.assert_array_equal(run.position, run.table_position)


def test_noise_is_white_gaussian_and_of_the_stated_size():
    noisy = dataclasses.replace(IDEAL, sensor=Sensor(noise=2e-8))
    run = run_of(noisy, seed=5)
    noise = (run.position - run.table_position) / 2e-8
    assert abs(np.mean(noise)) < 4 / np.sqrt(N)
    assert np.std(noise) == pytest.approx(1.0, abs=4 / np.sqrt(2 * N))
    assert np.mean(noise**4) == pytest.approx(3.0, abs=4 * np.sqrt(96 / N))
    for lag in (1, 2, 10):
        assert abs(np.mean(noise[lag:] * noise[:-lag])) < 4 / np.sqrt(N)


def test_noise_is_reproducible_by_its_seed_and_absent_without_one():
    noisy = dataclasses.replace(IDEAL, sensor=Sensor(noise=2e-8))
    first, again, other, none = (run_of(noisy, seed=seed) for seed in (3, 3, 4, None))
    np.testing.assert_array_equal(first.position, again.position)
    assert np.mean(first.position == other.position) < 0.01
    np.testing.assert_array_equal(none.position, none.table_position)
    np.testing.assert_array_equal(none.command, run_of().command)
