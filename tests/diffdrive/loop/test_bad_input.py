"""Bad input: each mistake is refused with the right error, which names the field and the mend; instability is a status.

An engineer who mistypes a unit must not get a simulation of another machine.
"""

import contextlib
import warnings

import equinox as eqx
import jax
import numpy as np
import pytest

from diffdrive import motion as motions
from diffdrive.controllers import (
    DOBVSC,
    PD,
    Cascade,
    DisturbanceObserver,
    Feedforward,
    FrictionCompensation,
    PDGains,
    Tracking,
)
from diffdrive.controllers.base import paper_tracking
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.errors import DivergenceError, MotionError, ParameterError, PrecisionError, ResultError
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Actuator, Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import directional
from diffdrive.motion.motion import Limits
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, LoadStateTuning

DRIVE = paper_drive(quantised=False)
MOVE = motions.jerk_limited(distance=2e-3, speed=0.01, acceleration=1.0, jerk=100.0, rate=10_000.0, dwell=0.02)
N = len(MOVE.time)
NAN, INF = float("nan"), float("inf")


def pd(kp=PAPER_KP, kd=PAPER_KD) -> PD:
    return PD(paper_tracking(DRIVE, kp, kd))


def having(place, value, drive=DRIVE):
    """The drive with one parameter replaced; `place` picks it."""
    return eqx.tree_at(place, drive, value, is_leaf=lambda leaf: leaf is None)


# --- the drive, the controller, the sampling --------------------------------------------------------------------------

PARAMETERS = {
    "negative mass": (lambda d: d.plant.mass, -100.0, "plant.mass must be above 0 kg"),
    "zero mass": (lambda d: d.plant.mass, 0.0, "plant.mass must be above 0 kg"),
    "NaN mass": (lambda d: d.plant.mass, NAN, "plant.mass must be finite"),
    "infinite mass": (lambda d: d.plant.mass, INF, "plant.mass must be finite"),
    "string mass": (lambda d: d.plant.mass, "100", "plant.mass must be a number in kg"),
    "bool mass": (lambda d: d.plant.mass, True, "plant.mass must be a number in kg"),
    "list mass": (lambda d: d.plant.mass, [100.0, 50.0], "plant.mass must be a number in kg"),
    "no mass": (lambda d: d.plant.mass, None, "plant.mass must be .*number|plant.mass must be finite"),
    "infinite force": (lambda d: d.plant.constant_force, -INF, "plant.constant_force must be finite"),
    "negative damping": (
        lambda d: d.plant.damping.negative,
        -1.0,
        r"plant.damping \(negative direction\) must be at least 0 N\*s/m",
    ),
    "zero stiffness": (
        lambda d: d.friction.bristle_stiffness.positive,
        0.0,
        r"friction.bristle_stiffness \(positive direction\) must be above 0 N/m",
    ),
    "negative gap": (
        lambda d: d.friction.breakaway_gap.positive,
        -90.0,
        "breakaway friction in the positive direction is .* breakaway_gap",
    ),
    "zero Stribeck velocity": (lambda d: d.friction.stribeck_velocity.negative, 0.0, "stribeck_velocity .*above 0 m/s"),
    "infinite Stribeck velocity": (lambda d: d.friction.stribeck_velocity.negative, INF, "stribeck_velocity .*finite"),
    "negative gap beside no Coulomb friction": (
        lambda d: (
            d.friction.coulomb_screw.negative,
            d.friction.load_coefficient.negative,
            d.friction.breakaway_gap.negative,
        ),
        (0.0, 0.0, -1.0),
        "breakaway friction in the negative direction is -1 N: it must be above 0, or 0 beside a Coulomb friction of 0",
    ),
    "zero resolution": (lambda d: d.sensor.resolution, 0.0, "sensor.resolution must be above 0 m"),
    "negative noise": (lambda d: d.sensor.noise, -1e-8, "sensor.noise must be at least 0 m"),
    "zero force limit": (lambda d: d.actuator.force_limit, 0.0, "actuator.force_limit must be above 0 N"),
    "negative delay": (lambda d: d.actuator, Actuator(delay_samples=-1), "actuator.delay_samples must be a whole"),
    "fractional delay": (lambda d: d.actuator, Actuator(delay_samples=1.5), "actuator.delay_samples must be a whole"),
    "all mass on the motor": (lambda d: d.effects, (Compliance(motor_share=1.0),), "motor_share must be below 1"),
    "more than all friction": (lambda d: d.effects, (Backlash(table_friction=1.1),), "table_friction must be at most"),
    "delay fraction above 1": (lambda d: d.actuator, Actuator(delay_fraction=1.5), "delay_fraction must be at most 1"),
}


@pytest.mark.parametrize(("place", "value", "says"), PARAMETERS.values(), ids=PARAMETERS.keys())
def test_a_bad_drive_is_refused(place, value, says):
    with pytest.raises(ParameterError, match=says):
        simulate_loop(having(place, value), pd(), MOVE)


def test_every_bad_parameter_is_named_at_once():
    bad = having(lambda d: (d.plant.mass, d.sensor.noise), (-1.0, NAN))
    with pytest.raises(ParameterError, match=r"plant\.mass.*; sensor\.noise"):
        simulate_loop(bad, pd(), MOVE)


def _dob(**changes):
    return DOBVSC(paper_tracking(DRIVE, PAPER_KP, PAPER_KD), DisturbanceObserver.of(DRIVE.plant, 240.0), **changes)


def _fc(observer):
    return FrictionCompensation(paper_tracking(DRIVE, PAPER_KP, PAPER_KD), observer)


CONTROLLERS = {
    "negative kp": (lambda: pd(kp=-1.0), "tracking.gains.kp must be at least 0 N/m"),
    "infinite kd": (lambda: pd(kd=INF), "tracking.gains.kd must be finite"),
    "negative feed-forward": (
        lambda: PD(Tracking(PDGains(1.0, 1.0), Feedforward(mass=-1.0))),
        "tracking.feedforward.mass must be at least 0 kg",
    ),
    "zero cut-off": (
        lambda: DOBVSC(pd().tracking, DisturbanceObserver.of(DRIVE.plant, 0.0)),
        "observer.cutoff must be above 0 Hz",
    ),
    "no boundary layer": (lambda: _dob(layer=0.0), "layer must be above 0 m/s"),
    "zero measurement noise": (
        lambda: _fc(LoadStateObserver(DRIVE.plant, DRIVE.friction, LoadStateTuning(measurement=0.0))),
        r"observer.tuning.measurement must be above 0 m\^2",
    ),
    "observer with no mass": (
        lambda: _fc(KalmanObserver(having(lambda d: d.plant.mass, 0.0).plant, DRIVE.friction)),
        "observer.plant.mass must be above 0 kg",
    ),
    "cascade over no samples": (lambda: Cascade(kp=50.0, kv=1e5, velocity_samples=0), "velocity_samples .*at least 1"),
}


@pytest.mark.parametrize(("build", "says"), CONTROLLERS.values(), ids=CONTROLLERS.keys())
def test_a_bad_controller_is_refused(build, says):
    with pytest.raises(ParameterError, match=says):
        simulate_loop(DRIVE, build(), MOVE)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"rate": 0.0}, "sampling.rate must lie between 10 and 1e6 Hz"),
        ({"rate": NAN}, "sampling.rate must lie"),
        ({"rate": -1e4}, "sampling.rate must lie"),
        ({"rate": "10 kHz"}, "sampling.rate must"),
        ({"substeps": 0}, "sampling.substeps must be a whole number of at least 1"),
        ({"substeps": 2.5}, "sampling.substeps must be a whole number"),
        ({"substeps": True}, "sampling.substeps must be a whole number"),
    ],
)
def test_bad_sampling_is_refused(arguments, says):
    with pytest.raises(ParameterError, match=says):
        Sampling(**arguments)


def test_three_values_for_a_direction_are_refused():
    with pytest.raises(ParameterError, match=r"exactly two entries \[positive, negative\], got 3"):
        directional([1.0, 2.0, 3.0])


# --- what the drive is asked to do ------------------------------------------------------------------------------------

REQUESTS = {
    "load below preload": (
        {"load": -16_000.0},
        MotionError,
        r"load of -16000 N at t = 0 s .*must stay above.*-15200 N",
    ),
    "load too short": ({"load": np.zeros(N - 1)}, MotionError, "give one load per sample"),
    "NaN load": ({"load": NAN}, MotionError, "load is not finite at t = 0 s"),
    "NaN in load": (
        {"load": np.where(np.arange(N) < 50, 0.0, NAN)},
        MotionError,
        r"load is not finite at t = 0\.005 s",
    ),
    "load with a unit": ({"load": "10 kN"}, (MotionError, ParameterError), "load .*N"),
    "beyond the stroke": ({"limits": Limits((0.0, 1e-3))}, MotionError, "position leaves the stroke 0 to 0.001 m"),
    "too fast": ({"limits": Limits(speed=0.005)}, MotionError, r"speed leaves 0\.005 m/s .*Shorten or slow"),
    "too much acceleration": ({"limits": Limits(acceleration=0.1)}, MotionError, r"acceleration leaves 0\.1 m/s\^2"),
    "other rate": (
        {"sampling": Sampling(5000.0)},
        ParameterError,
        "10000 Hz, the axis at 5000 Hz: delays are given in samples: make the rates equal",
    ),
    "every 0": ({"every": 0}, ParameterError, rf"every must be a whole number from 1 to {N - 1}, got 0"),
    "every negative": ({"every": -5}, ParameterError, "every must be a whole number"),
    "every fractional": ({"every": 2.5}, ParameterError, "every must be a whole number"),
    "every true": ({"every": True}, ParameterError, "every must be a whole number"),
    "seed true": ({"seed": True}, ParameterError, "seed must be a whole number of 64 bits"),
    "seed fractional": ({"seed": 1.5}, ParameterError, "seed must be a whole number of 64 bits"),
    "seeds": ({"seed": np.arange(3)}, ParameterError, "seed must be a whole number of 64 bits"),
    "every too large": ({"every": N}, ParameterError, "every must be a whole number"),
}


@pytest.mark.parametrize(("arguments", "error", "says"), REQUESTS.values(), ids=REQUESTS.keys())
def test_a_bad_request_is_refused(arguments, error, says):
    with pytest.raises(error, match=says):
        simulate_loop(DRIVE, pd(), **({"motion": MOVE} | arguments))


def test_whole_numbers_of_numpy_are_whole_numbers():
    noisy = having(lambda d: d.sensor, Sensor(noise=1e-8))
    run, same = (
        simulate_loop(noisy, pd(), MOVE, seed=3, every=2),
        simulate_loop(noisy, pd(), MOVE, seed=np.int64(3), every=np.int8(2)),
    )
    np.testing.assert_array_equal(same.position, run.position)


@pytest.mark.parametrize(
    ("time", "says"),
    [
        (np.r_[MOVE.time[:200], MOVE.time[200:] + 5e-5], "time is not uniform: .* resample it first"),
        (np.where(np.arange(N) == 100, NAN, MOVE.time), "time is not finite at sample 100"),
        (MOVE.time[::-1], "time does not increase at sample 1: sort it"),
    ],
)
def test_a_reference_with_a_bad_clock_is_refused(time, says):
    with pytest.raises(MotionError, match=says):
        motions.from_array(time, MOVE.position)


def test_single_precision_is_refused():
    jax.config.update("jax_enable_x64", False)
    try:
        with pytest.raises(PrecisionError, match=r"double precision.*jax_enable_x64"):
            simulate_loop(DRIVE, pd(), MOVE)
    finally:
        jax.config.update("jax_enable_x64", True)


# --- what is allowed, and goes wrong only when it runs ----------------------------------------------------------------

DELAYED = having(lambda d: d.actuator, Actuator(delay_samples=3))
# kd / M times the whole lag of 0.4 ms (delay, hold, difference) must stay below pi / 2: kd below 3.9e5 N s/m
UNSTABLE = {
    "kd 40 times too high": (DELAYED, pd(kd=40 * PAPER_KD)),
    "kp huge": (DRIVE, pd(kp=1e12)),
    "kp beyond all floats": (DRIVE, pd(kp=1e300)),
    "cascade": (DELAYED, Cascade(kp=50.0, kv=40 * PAPER_KD)),
    "disturbance observer": (DELAYED, _dob(reach=1e9)),
    "friction observer": (
        DELAYED,
        FrictionCompensation(
            paper_tracking(DRIVE, PAPER_KP, 40 * PAPER_KD), LoadStateObserver(DRIVE.plant, DRIVE.friction)
        ),
    ),
}


@contextlib.contextmanager
def no_warnings():
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        yield


@pytest.mark.parametrize(("drive", "controller"), UNSTABLE.values(), ids=UNSTABLE.keys())
def test_an_unstable_loop_is_a_status_that_names_signal_and_time(drive, controller):
    with no_warnings():
        run = simulate_loop(drive, controller, MOVE)
    status = run.status
    assert not status.ok
    assert status.signal in ("tracking error", "command", "friction estimate", "load estimate", "velocity")
    assert 0 < status.time <= MOVE.duration
    assert f"diverged: {status.signal} leaves" in status.message
    assert f"at t = {status.time:g} s" in status.message
    assert "lower kd, kp or the delay" in status.message
    before = run.time < status.time  # the first signal that left is the one named
    assert np.max(np.abs(run.error[before])) <= 0.1
    assert np.all(np.isfinite(run.command[before]))
    assert np.all(np.isfinite(run.velocity[before]))
    with pytest.raises(DivergenceError, match="diverged") as caught:
        run.require_ok()
    assert str(caught.value) == status.message


def test_a_stable_loop_is_ok_up_to_its_known_limit():
    run = simulate_loop(DELAYED, pd(kd=20 * PAPER_KD), MOVE)  # 0.8 of the limit above
    assert run.status.ok
    assert run.require_ok() is run
    assert run.peak_error() < 20e-6


def test_an_axis_too_weak_for_its_friction_stands_still_within_its_limit():
    with no_warnings():
        run = simulate_loop(having(lambda d: d.actuator, Actuator(force_limit=10.0)), pd(), MOVE)
    assert np.max(np.abs(run.force)) == 10.0
    assert np.max(np.abs(run.table_position)) < 1e-6  # the bristles give 10 N / 33.5 N/um
    assert run.peak_error() == pytest.approx(2e-3, rel=1e-3)
    assert not run.status.ok
    assert "saturated: the command exceeds the force limit of 10 N" in run.status.message
    with pytest.raises(ResultError, match="saturated") as caught:
        run.require_ok()
    assert not isinstance(caught.value, DivergenceError)  # it did not diverge


def test_an_axis_too_weak_for_its_weight_is_said_to_be_so():
    weak = having(lambda d: (d.actuator, d.plant.constant_force), (Actuator(force_limit=10.0), -1e3))
    with no_warnings():
        run = simulate_loop(weak, pd(), MOVE)
    assert not run.status.ok
    assert "the force sits at its limit of 10 N; raise force_limit" in run.status.message


def test_a_load_of_a_giganewton_still_gives_finite_numbers():
    with no_warnings():
        run = simulate_loop(DRIVE, pd(), MOVE, load=1e9)
    for signal in (run.table_position, run.velocity, run.command, run.force, run.friction):
        assert np.all(np.isfinite(signal))
    assert run.status.ok
    assert np.max(np.abs(run.friction)) < 3.66e-4 * (1e9 + 15_200) + 100


def test_a_drive_whose_controller_is_unknown_can_be_read_but_not_simulated():
    from diffdrive.controllers import UnknownController

    with pytest.raises(ParameterError, match="controller is 'unknown': to simulate its loop"):
        simulate_loop(paper_drive(), UnknownController(), MOVE)
