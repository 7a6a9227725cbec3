"""Does eq. (20) converge, how fast, and to what: the theory against the paper's notes and against simulation."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax
from scipy.linalg import solve_discrete_are

from diffdrive import motion
from diffdrive.controllers import FrictionCompensation
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import LoadEstimatorError
from diffdrive.loop.convergence import (
    convergence_gain,
    convergence_gains,
    divergent_speeds,
    steady_covariance,
    time_constants,
)
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.friction import lugre_coefficients, steady_friction
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.model.transition import state_matrices
from diffdrive.observers.friction_observer import KalmanObserver, Tuning
from diffdrive.observers.load_estimator import InnovationLoad

PERIOD = 1e-4
SPEEDS = [0.001, 0.003, 0.010, 0.015, 0.020, 0.040]
TUNINGS = [Tuning(1e-15, 1e-10, 1e-12), Tuning(1e-18, 1e-11, 1e-10), Tuning(1e-15, 1e-8, 1e-14)]
NOTES = np.array([
    [3.3e-2, 6.1e-2, 1.7e-2, -1.7e-3, 5.5e-3, 1.2e-2],
    [3.8e-2, 1.0e-1, 1.3e-1, 7.7e-3, 8.0e-2, 9.6e-2],
    [-2.8e-3, -7.7e-3, -3.5e-3, -1.9e-3, -8.3e-4, 9.3e-4],
])  # fmt: skip


SETTLED_AT = (1e-4, 0.01, -0.1)  # m/s


def observer_of(drive, tuning=TUNINGS[0], **estimator):
    return KalmanObserver(drive.plant, drive.friction, tuning, InnovationLoad(**estimator))


@pytest.mark.parametrize("row", range(3))
def test_gain_is_that_of_the_notes(drive, row):
    gains = convergence_gains(observer_of(drive, TUNINGS[row]), SPEEDS, PERIOD)
    half_a_digit = 0.5 * 10.0 ** (np.floor(np.log10(np.abs(NOTES[row]))) - 1)
    allowed = np.maximum(0.02 * np.abs(NOTES[row]), half_a_digit)
    assert np.all(np.abs(gains - NOTES[row]) <= allowed), gains


def slid_past(observer, speed, extra, load, steps):
    """Settled change of What per step and unit K_w, the table sliding with `extra` newtons more than is believed."""
    force = steady_friction(observer.friction, speed, load) + observer.plant.damping.towards(speed) * speed
    wrong = eqx.tree_at(lambda o: o.friction.coulomb_screw, observer, replace_fn=lambda f: shifted(f, -extra))
    level = abs(force) - (observer.friction.viscous.towards(speed) + observer.plant.damping.towards(speed)) * abs(speed)
    start = observer.init(jnp.zeros(()))
    start = start._replace(x=(0.0 * speed, speed, jnp.sign(speed) * level / 3.35e7), load=load + 0.0 * speed)

    def body(state, k):
        state, _ = wrong.step(state, force, speed * PERIOD * (k + 1), PERIOD)
        return state, state.load

    loads = lax.scan(body, start, jnp.arange(steps))[1]
    return (loads[-1] - loads[-2]) / observer.load_estimator.gain


def shifted(pair, extra):
    return jax.tree.map(lambda value: value + extra, pair)


@pytest.mark.long
@pytest.mark.parametrize("row", range(3))
@pytest.mark.parametrize("load", [0.0, 8_000.0])
def test_gain_is_what_a_simulated_observer_does(drive, row, load):
    still = observer_of(drive, TUNINGS[row], gain=1e-6, min_speed=0.0, floor=None)
    speeds = np.array(SPEEDS + [-v for v in SPEEDS])
    per_newton = jax.jit(jax.vmap(lambda v, extra: slid_past(still, v, extra, load, 6000), in_axes=(0, None)))
    simulated = np.asarray(per_newton(speeds, 0.1) - per_newton(speeds, -0.1)) / 0.2
    gains = convergence_gains(still, speeds, PERIOD, load)
    np.testing.assert_allclose(simulated, gains, rtol=1e-2, atol=1e-6)


@pytest.mark.parametrize("speed", [0.003, 0.010, -0.010, 0.040])
def test_load_error_decays_with_the_time_constant(drive, speed):
    observer = observer_of(drive, min_speed=0.0, floor=None, gain=20.0, initial_load=0.0)
    expected = time_constants(observer, [speed], PERIOD)[0]
    force = steady_friction(observer.friction, speed, 100.0) + observer.plant.damping.towards(speed) * speed
    steps = int(4 * expected / PERIOD)

    def body(state, k):
        state, _ = observer.step(state, force, speed * PERIOD * (k + 1), PERIOD)
        return state, state.load

    start = observer.init(jnp.zeros(()))
    start = start._replace(x=(jnp.zeros(()), jnp.asarray(speed), jnp.sign(speed) * 2.1e-6))
    error = 100.0 - np.asarray(lax.scan(body, start, jnp.arange(steps))[1])
    fitted = -1 / np.polyfit(PERIOD * np.arange(steps // 4, steps), np.log(error[steps // 4 :]), 1)[0]
    assert abs(fitted / expected - 1) < 0.05


def _at(drive, tuning, speed):
    """The transition at a speed and the process noise of a tuning."""
    ad, _ = state_matrices(drive.plant, lugre_coefficients(drive.friction, speed, speed, 0.0), speed, PERIOD)
    return np.array([[float(entry) for entry in row] for row in ad]), np.array(tuning.process)


@pytest.fixture(scope="module")
def settled(drive):
    """Covariances after 20 000 samples, by speed and tuning: the recursion step by step, all of them side by side."""
    cases = [(speed, k) for speed in SETTLED_AT for k in range(len(TUNINGS))]
    ad = np.stack([_at(drive, TUNINGS[k], speed)[0] for speed, k in cases])
    added = np.stack([np.diag(TUNINGS[k].process) for _, k in cases])
    r = np.array([TUNINGS[k].measurement for _, k in cases])[:, None, None]
    omega = added
    for _ in range(20_000):
        k = omega[:, :, :1] / (omega[:, :1, :1] + r)
        left = np.eye(3) - k @ np.eye(3)[:1]
        omega = ad @ (left @ omega @ left.mT + r * k @ k.mT) @ ad.mT + added
    return dict(zip(cases, omega, strict=True))


@pytest.mark.parametrize("case", range(len(TUNINGS)))
@pytest.mark.parametrize("speed", SETTLED_AT)
def test_steady_covariance_is_where_the_filter_settles(drive, settled, case, speed):
    tuning, omega = TUNINGS[case], settled[speed, case]
    ad, process = _at(drive, tuning, speed)
    found = np.asarray(jax.jit(steady_covariance)(jnp.asarray(ad), jnp.asarray(process), tuning.measurement))
    r = tuning.measurement
    size = np.sqrt(np.diag(omega))
    np.testing.assert_allclose(found / np.outer(size, size), omega / np.outer(size, size), atol=1e-8)
    scaled = ad * size / size[:, None]
    noise = np.diag(process / size**2)
    riccati = solve_discrete_are(scaled.T, np.eye(3)[:, :1], noise, np.array([[r / size[0] ** 2]]))
    np.testing.assert_allclose(found / np.outer(size, size), riccati, atol=1e-6)


@pytest.fixture(scope="module")
def gains(drive):
    """The gain at a speed as a function of the filter's tuning, and its reverse and forward derivatives."""

    def gain(log_tuning, speed):
        return convergence_gain(observer_of(drive, Tuning(*jnp.exp(log_tuning))), speed, PERIOD)

    return jax.jit(gain), jax.jit(jax.grad(gain)), jax.jit(jax.jacfwd(gain))


@pytest.mark.long
@pytest.mark.parametrize("speed", [-0.010, *(pytest.param(one, marks=pytest.mark.slow) for one in (0.001, 0.040))])
def test_derivative_of_the_gain_by_the_filter_tuning(gains, speed):
    gain, reverse, forwards = gains
    at = jnp.log(jnp.array([1e-15, 1e-10, 1e-12, 8.3e-16]))
    slope, forward = reverse(at, speed), forwards(at, speed)

    def change(step):
        return gain(at + step, speed) - gain(at - step, speed)

    central = [(8 * change(step) - change(2 * step)) / (12 * 1e-2) for step in 1e-2 * np.eye(4)]
    np.testing.assert_allclose(slope, central, rtol=1e-5, atol=1e-6 * np.abs(slope).max())
    np.testing.assert_allclose(slope, forward, rtol=1e-9, atol=1e-12)


def test_a_divergent_tuning_is_known_by_its_speeds(drive):
    bad = observer_of(drive, TUNINGS[0], min_speed=0.0)
    assert divergent_speeds(bad, SPEEDS, PERIOD) == [0.015]
    assert divergent_speeds(observer_of(drive, TUNINGS[2], min_speed=0.0), SPEEDS, PERIOD) == [
        0.001, 0.003, 0.010, 0.015, 0.020,
    ]  # fmt: skip
    assert divergent_speeds(observer_of(drive, TUNINGS[1], min_speed=0.0), SPEEDS, PERIOD) == []
    assert divergent_speeds(observer_of(drive, TUNINGS[0], min_speed=0.040), SPEEDS, PERIOD) == []
    assert np.isinf(time_constants(bad, SPEEDS, PERIOD)).tolist() == [v == 0.015 for v in SPEEDS]


def test_there_is_no_gain_at_standstill(drive):
    with pytest.raises(LoadEstimatorError, match="stick"):
        convergence_gains(observer_of(drive), [0.01, 0.0], PERIOD)


def wrong_by(drive, part, name, extra):
    module = getattr(drive, part)
    return eqx.tree_at(lambda m: getattr(m, name), module, replace_fn=lambda pair: shifted(pair, -extra))


@pytest.mark.parametrize(
    ("speed", "part", "name", "extra", "newtons"),
    [
        (0.010, "friction", "coulomb_screw", 1.0, 1.0),
        (-0.010, "friction", "coulomb_screw", 1.0, 1.0),
        (0.010, "friction", "viscous", 100.0, 1.0),
        (-0.008, "friction", "viscous", 100.0, 0.8),
        (0.010, "plant", "damping", 60.0, 0.6),
        (0.008, "friction", "breakaway_gap", 8.0, 8.0 * np.exp(-8.0)),
        (0.003, "friction", "breakaway_gap", 8.0, 8.0 * np.exp(-3.0)),
    ],
)
def test_every_steady_friction_error_ends_in_the_load(drive, speed, part, name, extra, newtons):
    """What -> W + (dF_BC + dF_Stribeck + (d mu_v + dB_S) |v|) / mu_LC, the machine above its model by d."""
    weight = 2_000.0
    believed = wrong_by(drive, part, name, extra)
    plant, friction = (believed, drive.friction) if part == "plant" else (drive.plant, believed)
    observer = KalmanObserver(plant, friction, TUNINGS[1], InnovationLoad(min_speed=2e-3, gain=200.0))
    time = np.arange(10_001) * PERIOD
    steady = motion.from_array(time, speed * np.where(time < 0.1, time**2 / 0.2, time - 0.05))
    run = simulate_loop(
        drive, FrictionCompensation(paper_tracking(drive, PAPER_KP, PAPER_KD), observer), steady, weight
    )
    expected = weight + newtons / 3.66e-4
    np.testing.assert_allclose(run.load_estimate[-100:], expected, rtol=1e-3)
    np.testing.assert_allclose(run.load_estimate[-100:] - weight, newtons / 3.66e-4, rtol=1e-3, atol=0.1)
