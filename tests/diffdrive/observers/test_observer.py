"""The observers against the textbook filter in matrices, and the rules of the load estimator of eq. (20)."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from jax import lax
from scipy.linalg import expm

from diffdrive import motion
from diffdrive.controllers import PD, FrictionCompensation
from diffdrive.controllers.base import paper_tracking
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion import load
from diffdrive.numerics.arrays import as_arrays
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, LoadStateTuning, Tuning
from diffdrive.observers.kalman import full_matrix
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad

PERIOD = 1e-4
MASS, STIFFNESS, DAMPING, GUIDE, PRELOAD = 100.0, 3.35e7, 4.54e3, 3.66e-4, 15_200.0


def coefficients(velocity, load):
    """g(v), mu_v and B_S of Tables 2 and 3 for the direction of motion."""
    if velocity >= 0:
        screw, gap, stribeck, viscous, system = 63.43, 30.0, 0.0010, 1826.5, 380.0
    else:
        screw, gap, stribeck, viscous, system = 64.95, 22.98, 0.0014, 1673.5, 260.0
    return screw + GUIDE * (PRELOAD + load) + gap * np.exp(-abs(velocity) / stribeck), viscous, system


def friction_of(x, load):
    """Eq. (18)."""
    g, viscous, _ = coefficients(x[1], load)
    return (DAMPING + viscous) * x[1] + STIFFNESS * (1 - DAMPING * abs(x[1]) / g) * x[2]


class Oracle:
    """The paper's filter, eqs. (8) to (20), as a textbook writes it: n states, the fourth, if any, a load."""

    def __init__(self, process, measurement, load_gain=0.0, min_speed=0.0, floor=-np.inf):
        self.q, self.r, self.n = np.diag(process), measurement, len(process)
        self.x, self.omega, self.load = np.zeros(3), np.diag(process).astype(float), 0.0
        self.load_gain, self.min_speed, self.floor = load_gain, min_speed, floor

    def model(self):
        """A of [x, v, z, W, u]: W bends the bristle through g, u is the force."""
        _, v, z = self.x
        g, viscous, system = coefficients(v, self.load)
        push = STIFFNESS * abs(v) * z / g**2 * GUIDE
        a = np.zeros((5, 5))
        a[0, 1] = 1
        a[1, 1:] = np.array([
            -(DAMPING + viscous + system), -STIFFNESS * (1 - DAMPING * abs(v) / g), -DAMPING * push, 1.0
        ]) / MASS  # fmt: skip
        a[2, 1:4] = 1, -STIFFNESS * abs(v) / g, push
        return a

    def step(self, force, position):
        n, speed = self.n, self.x[1]
        transition = expm(self.model() * PERIOD)
        predicted = transition[:3, :3] @ self.x + transition[:3, 4] * force
        ad = transition[:n, :n]
        omega = ad @ self.omega @ ad.T + self.q
        c = np.eye(n)[:1]
        k = omega @ c.T / (c @ omega @ c.T + self.r)
        innovation = position - predicted[0]
        self.x = predicted + k[:3, 0] * innovation
        left = np.eye(n) - k @ c
        self.omega = left @ omega @ left.T + self.r * k @ k.T
        before, after = friction_of(predicted, self.load), friction_of(self.x, self.load)
        if n == 4:
            self.load = max(self.load + k[3, 0] * innovation, self.floor)
            after = friction_of(self.x, self.load)
        elif abs(speed) > self.min_speed:
            self.load = max(self.load + np.sign(speed) * self.load_gain * (after - before), self.floor)
        return after


@pytest.fixture(scope="module")
def log():
    """Force that acted and position measured at 2000 samples: a reversal at 10 mm/s under a growing load."""
    drive = paper_drive(quantised=True)
    there = motion.triangular(speed=0.01, stroke=0.0008, rounding=0.04, duration=0.2, rate=1e4)
    weight = load.ramp(there.time, start=0.02, end=0.15, to=5e3)
    pd = PD(paper_tracking(drive, PAPER_KP, PAPER_KD))
    frames = rollout_loop(*as_arrays((drive, pd)), loop_inputs(there, weight), Sampling())
    assert np.ptp(np.sign(frames.velocity)) == 2
    force = np.concatenate([[0.0], frames.force])[:2000]
    return force, np.asarray(frames.measured)[:2000]


def observers(drive):
    tunings = {"paper": Tuning(), "other": Tuning(1e-18, 1e-11, 1e-10)}
    for name, tuning in tunings.items():
        oracle = {"process": tuning.process, "measurement": tuning.measurement}
        yield f"FC {name}", KalmanObserver(drive.plant, drive.friction, tuning), oracle
        estimator = InnovationLoad(gain=50.0, min_speed=2e-3, floor=-20.0)
        settings = oracle | {"load_gain": 50.0, "min_speed": 2e-3, "floor": -20.0}
        yield f"LE {name}", KalmanObserver(drive.plant, drive.friction, tuning, estimator), settings
    for floor in (0.0, None):
        tuning = LoadStateTuning()
        oracle = {"process": tuning.process, "measurement": tuning.measurement}
        bottom = -np.inf if floor is None else floor
        yield (
            f"load state {floor}",
            LoadStateObserver(drive.plant, drive.friction, floor=floor),
            oracle | {"floor": bottom},
        )


CASES = {name: case for name, *case in observers(paper_drive())}


@pytest.mark.long
@pytest.mark.parametrize("name", CASES)
def test_observer_is_the_textbook_filter(log, name):
    observer, settings = CASES[name]
    oracle = Oracle(**settings)

    def body(state, sample):
        state, estimate = observer.step(state, *sample, PERIOD)
        return state, (state, estimate)

    _, (states, estimates) = jax.jit(lambda log: lax.scan(body, observer.init(jnp.zeros(())), log))(log)
    x, covariance = np.array(states.x).T, np.moveaxis(np.array(full_matrix(states.covariance)), -1, 0)
    for k, sample in enumerate(zip(*log, strict=True)):
        friction = oracle.step(*sample)
        if k in (0, 1, 10, 100, 700, 1000, 1999):
            np.testing.assert_allclose(x[k], oracle.x, rtol=1e-8, atol=1e-16)
            size = np.sqrt(np.diag(oracle.omega))
            assert np.abs((covariance[k] - oracle.omega) / np.outer(size, size)).max() < 1e-8
            np.testing.assert_allclose(states.load[k], oracle.load, rtol=1e-8, atol=1e-7)
            np.testing.assert_allclose(estimates.friction[k], friction, rtol=1e-8, atol=1e-9)
    assert name.startswith("FC") or np.ptp(states.load) > 100.0


@jax.jit
def covariances(observer, log):
    def body(state, sample):
        state, _ = observer.step(state, *sample, PERIOD)
        return state, None

    # a load estimate that runs away would leave the model: only the covariance is looked at, at the recorded positions
    state, _ = lax.scan(body, observer.init(jnp.zeros(())), log)
    return jnp.stack([jnp.stack(row) for row in full_matrix(state.covariance)])


DECADES = st.floats(-20, -6).map(lambda exponent: 10.0**exponent)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(q=st.tuples(DECADES, DECADES, DECADES), weight=st.floats(-3, 6), r=st.floats(-20, -10), four=st.booleans())
def test_covariance_stays_positive(log, q, weight, r, four):
    drive = paper_drive()
    if four:
        observer = LoadStateObserver(drive.plant, drive.friction, LoadStateTuning(*q, 10.0**weight, 10.0**r))
    else:
        observer = KalmanObserver(drive.plant, drive.friction, Tuning(*q, 10.0**r))
    omega = np.asarray(covariances(as_arrays(observer), log))
    size = np.sqrt(np.diag(omega))
    assert np.all(size > 0)
    assert np.linalg.eigvalsh(omega / np.outer(size, size)).min() > -1e-9


def test_fixed_load_stays():
    assert FixedLoad(700.0).step(700.0, 0.01, 1.0, 5.0) == 700.0


@pytest.mark.parametrize(("velocity", "moved"), [(0.01, 300.0), (-0.01, -300.0), (0.0, 0.0)])
def test_load_moves_with_the_sign_of_the_velocity(velocity, moved):
    estimator = InnovationLoad(gain=100.0, min_speed=0.0, floor=None)
    assert estimator.step(1000.0, velocity, 2.0, 5.0) == 1000.0 + moved


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_load_is_frozen_at_or_below_the_minimum_speed(sign):
    estimator = InnovationLoad(min_speed=5e-3)
    assert estimator.step(1000.0, sign * 5e-3, 2.0, 5.0) == 1000.0
    assert estimator.step(1000.0, sign * 5.001e-3, 2.0, 5.0) == 1000.0 + sign * 300.0


def test_load_stops_at_the_floor():
    assert InnovationLoad(floor=0.0).step(100.0, 0.01, 5.0, 2.0) == 0.0
    assert InnovationLoad(floor=-50.0).step(100.0, 0.01, 5.0, 2.0) == -50.0
    assert InnovationLoad(floor=None).step(100.0, 0.01, 5.0, 2.0) == -200.0


def test_smooth_gate_opens_around_the_minimum_speed():
    estimator = InnovationLoad(min_speed=5e-3, rounding=5e-4, floor=None)
    opened = [float(estimator.step(0.0, v, 0.0, 1.0)) / 100.0 for v in (0.0, 5e-3, 1e-2)]
    np.testing.assert_allclose(opened, [0.0, 0.5, 1.0], atol=1e-4)


@pytest.mark.parametrize("observer", [KalmanObserver, LoadStateObserver])
@pytest.mark.parametrize("speed", [1e-3, 0.01, -0.01, 0.1])
def test_a_matched_model_is_not_surprised_at_constant_speed(drive, observer, speed):
    time = np.arange(8001) * PERIOD
    steady = motion.from_array(time, speed * np.where(time < 0.1, time**2 / 0.2, time - 0.05))
    loop = FrictionCompensation(paper_tracking(drive, PAPER_KP, PAPER_KD), observer(drive.plant, drive.friction))
    frames = roll(*as_arrays((drive, loop)), loop_inputs(steady, np.zeros(8001)))
    assert np.abs(frames.estimate.innovation[-500:]).max() < 1e-14
    np.testing.assert_allclose(frames.estimate.friction[-500:], frames.friction[-500:], rtol=1e-6)
    np.testing.assert_allclose(frames.estimate.velocity[-500:], speed, rtol=1e-6)


roll = jax.jit(lambda drive, controller, inputs: rollout_loop(drive, controller, inputs, Sampling()))
