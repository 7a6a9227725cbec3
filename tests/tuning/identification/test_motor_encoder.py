"""The motor's encoder beside the scale: one filter for both, and what the fit gains by it."""

from dataclasses import replace
from functools import cache

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from diffdrive.effects.transmission import Compliance
from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.logs.checks.finding import Finding
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model import plant
from diffdrive.model.parameters import Sensor
from diffdrive.numerics.arrays import as_arrays
from diffdrive.observers.kalman import full_matrix, kalman_gain_along, update_covariance_along
from experiments.studies.recovery.excitation import CREEPING, FAST, MEDIUM, SLOW, STRONG, concatenate, resting, strokes
from tests.support.asymmetric_drive import ASYMMETRIC
from tests.support.sound_log import RATE, axis_of
from tuning.identification.filter_gain import filter_lanes
from tuning.identification.identify import identify
from tuning.identification.motor_encoder import with_motor_encoder, without_doubtful_encoder
from tuning.identification.prediction import Lanes, MotorReadings, constant_gains, predict
from tuning.identification.problem import Innovations, lanes_of, sampling_of
from tuning.identification.refinement import evaluated
from tuning.identification.setup import build_problem
from tuning.optimisation.space import coordinates

SAMPLING = sampling_of(RATE, 50e-6)
NOISE, MOTOR_NOISE = 3e-7, 3e-9  # m
COMPLIANCE = 1e-8  # m/N
RESOLUTION, MOTOR_RESOLUTION = 1e-6, 1e-8  # m
DRIVE = replace(axis_of(noise=0.0, resolution=RESOLUTION).drive, motor_encoder=Sensor(resolution=MOTOR_RESOLUTION))


# --- the filter


def test_two_measurements_one_after_the_other_are_both_at_once():
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3))
    before, outputs, noises = root @ root.T, np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.4]]), np.array([0.3, 0.01])
    innovations = rng.normal(size=2)
    gain = before @ outputs.T @ np.linalg.inv(outputs @ before @ outputs.T + np.diag(noises))
    state, covariance = np.zeros(3), tuple(tuple(before[i, i:].tolist()) for i in range(3))
    for output, noise, measured in zip(outputs, noises, innovations, strict=True):
        one, seen, variance = kalman_gain_along(covariance, tuple(output.tolist()), float(noise))
        state = state + np.array(one) * (measured - output @ state)
        covariance = update_covariance_along(covariance, one, seen, variance)
    np.testing.assert_allclose(state, gain @ innovations, rtol=1e-12)
    np.testing.assert_allclose(full_matrix(covariance), before - gain @ outputs @ before, atol=1e-14)


@cache
def clean_lanes():
    """What an exact machine shows under a force that reverses: the scale, and a motor that its friction winds up."""
    time = np.arange(400) / RATE
    force = 150.0 * np.sin(2.0 * np.pi * 8.0 * time) + 20.0 * np.sin(2.0 * np.pi * 41.0 * time)

    def body(state, push):
        ahead = plant.advance(as_arrays(ASYMMETRIC), state, push, 0.0, SAMPLING.period, SAMPLING.plant_steps)
        return ahead, state

    states = lax.scan(body, plant.at_rest(jnp.zeros(())), jnp.asarray(force))[1]
    ahead = COMPLIANCE * ASYMMETRIC.friction.bristle_stiffness.towards(states.bristle) * states.bristle
    one = jnp.ones((1, len(time)))
    position = states.position[None]
    motor = MotorReadings(position + ahead, one, jnp.full(1, MOTOR_NOISE), jnp.ones(1))
    return Lanes(position, jnp.asarray(force)[None], 0.0 * one, 0.0 * one, one, jnp.zeros(1), motor=motor)


predicted = eqx.filter_jit(predict)


def gains_of(lanes, process=1e-3, compliance=COMPLIANCE):
    return filter_lanes(as_arrays(ASYMMETRIC), 0.0, process, NOISE, lanes, SAMPLING, compliance).gains


@pytest.mark.long
def test_both_encoders_of_an_exact_machine_are_foreseen_to_rounding():
    lanes = clean_lanes()
    assert np.ptp(lanes.motor.position - lanes.position) > 1e-6
    for gains in (gains_of(lanes), gains_of(lanes, 10.0), constant_gains(200.0, NOISE, lanes, SAMPLING.period)):
        found = predicted(as_arrays(ASYMMETRIC), jnp.zeros(()), gains, lanes, SAMPLING, jnp.asarray(COMPLIANCE))
        assert np.max(np.abs(found.innovation)) < 1e-14
        assert np.max(np.abs(found.motor_innovation)) < 1e-14
    stiff = predicted(as_arrays(ASYMMETRIC), jnp.zeros(()), gains_of(lanes), lanes, SAMPLING, jnp.zeros(()))
    assert np.max(np.abs(stiff.motor_innovation)) > 100.0 * MOTOR_NOISE


@pytest.mark.long
def test_the_filter_expects_of_the_finer_encoder_what_that_scatters_by():
    lanes = clean_lanes()
    both, scale = gains_of(lanes), gains_of(lanes._replace(motor=None))
    # what follows a coarse scale alone is less sure of the position than one that follows both
    assert np.all(both.innovation_std[0, 50:] < scale.innovation_std[0, 50:])
    assert np.all(both.motor.innovation_std[0, 50:] < 2.0 * MOTOR_NOISE)
    assert scale.motor is None


@pytest.mark.long
def test_an_encoder_that_is_nowhere_measured_changes_nothing():
    lanes = clean_lanes()
    noise = NOISE * np.random.default_rng(0).normal(size=lanes.position.shape)
    lanes = lanes._replace(position=lanes.position + noise)
    unmeasured = lanes.motor._replace(position=lanes.motor.position + 1.0, counts=0.0 * lanes.motor.counts)
    alone = filter_lanes(as_arrays(ASYMMETRIC), 0.0, 1.0, NOISE, lanes._replace(motor=None), SAMPLING)
    beside = filter_lanes(
        as_arrays(ASYMMETRIC), 0.0, 1.0, NOISE, lanes._replace(motor=unmeasured), SAMPLING, COMPLIANCE
    )
    np.testing.assert_allclose(beside.deviance, alone.deviance, rtol=1e-9)
    np.testing.assert_allclose(beside.gains.velocity, alone.gains.velocity, rtol=1e-6, atol=1e-12)


# --- what the fit is given


def path(seconds=4.0):
    """Time, position and velocity of a motion there and back."""
    time = np.arange(round(seconds * RATE)) / RATE
    slow, fast = 2.0 * np.pi * 0.6, 2.0 * np.pi * 1.9
    position = 0.02 * (1.0 - np.cos(slow * time)) + 0.003 * (1.0 - np.cos(fast * time))
    return time, position, 0.02 * slow * np.sin(slow * time) + 0.003 * fast * np.sin(fast * time)


def moved(seconds=4.0, resolution=RESOLUTION, motor_resolution=MOTOR_RESOLUTION, apart=0.0):
    """The motion without a machine, as both encoders read it; `apart` (m) is what the motor is ahead by."""
    time, position, velocity = path(seconds)
    motor = position + apart
    command = 100.0 * np.gradient(velocity, time) + 80.0 * np.tanh(velocity / 1e-4)
    steps = [step * np.round(one / step) for one, step in ((position, resolution), (motor, motor_resolution))]
    return Log("moved", time=time, position=steps[0], command=command, motor_position=steps[1])


def both_of(log, drive=DRIVE):
    lanes = lanes_of([log])
    return lanes, with_motor_encoder([log], drive, lanes, RESOLUTION / np.sqrt(12.0), RATE)


def test_the_coarser_encoder_is_brought_to_the_finer_ones_zero_scale_and_time():
    _, position, velocity = path()
    log = moved(apart=0.321 + 2e-4 * velocity + 1e-4 * position)
    lanes, both = both_of(log)
    assert np.std(log.motor_position - log.position) > 10.0 * RESOLUTION
    between = np.asarray(both.lanes.motor.position - both.lanes.position)[0]
    assert np.std(between) < RESOLUTION
    assert np.std(np.diff(np.asarray(both.lanes.motor.position)[0] - log.motor_position)) < 1e-12  # as it was read
    assert both.noise == pytest.approx(RESOLUTION / np.sqrt(12.0), rel=0.3)
    assert float(both.lanes.motor.noise[0]) == pytest.approx(MOTOR_RESOLUTION / np.sqrt(12.0), rel=0.3)
    assert abs(np.mean(both.lanes.position - lanes.position)) < 0.5e-3  # the zero stays the scale's


def test_a_motor_encoder_that_is_coarser_leaves_the_scale_as_it_is():
    log = moved(resolution=1e-8, motor_resolution=1e-6)
    lanes = lanes_of([log])
    drive = replace(DRIVE, sensor=Sensor(resolution=1e-8), motor_encoder=Sensor(resolution=1e-6))
    both = with_motor_encoder([log], drive, lanes, 3e-9, RATE)
    assert np.array_equal(both.lanes.position, lanes.position)
    assert both.noise == 3e-9
    assert not np.any(both.lanes.motor.leads)


def test_what_the_two_are_apart_beyond_the_model_is_noise_of_the_coarser():
    time = path()[0]
    wander = 4e-6 * np.sin(2.0 * np.pi * 3.3 * time) * np.sin(2.0 * np.pi * 0.17 * time)
    _, both = both_of(moved(apart=wander))
    assert both.noise > 1e-6
    assert float(both.lanes.motor.noise[0]) < 1e-8


def test_an_encoder_of_which_the_checks_warn_is_left_out_and_said():
    log = moved()
    note, warning = (
        Finding(severity, "motor_position", "so much apart", "look", "lost motion") for severity in ("note", "warning")
    )
    (same,), nothing = without_doubtful_encoder([log], [("moved", note), ("another", warning)])
    assert same is log
    assert nothing == []
    (scale,), (said,) = without_doubtful_encoder([log], [("moved", warning)])
    assert scale.motor_position is None
    assert all(np.array_equal(values, getattr(log, name)) for name, values in scale.channels.items())
    assert said == "moved: the scale alone is fitted, and not the motor's encoder: so much apart"
    assert without_doubtful_encoder([scale], [("moved", warning)]) == ((scale,), [])


def test_compliance_is_looked_for_only_where_two_encoders_show_it():
    log = moved()
    setup = build_problem([log], DRIVE, (), {})
    assert [one.path for one in setup.free][-1] == "compliance"
    held = build_problem([log], DRIVE, ("compliance",), {})
    assert "compliance" not in [one.path for one in held.free]
    assert held.problem.unknowns.compliance == 0.0
    scale = build_problem([log.replace(motor_position=None)], DRIVE, (), {})
    assert scale.problem.unknowns.compliance is None
    assert scale.problem.lanes.motor is None
    assert scale.problem.gains.motor is None
    assert scale.noise == scale.scale_noise
    with pytest.raises(ParameterError, match="cannot bound compliance: no log has a motor encoder"):
        build_problem([log.replace(motor_position=None)], DRIVE, (), {"compliance": (0.0, 1e-8)})


def test_a_resting_log_has_no_second_encoder_and_is_fitted_as_before():
    log = moved()
    rest = log.replace(position=0.0 * log.position, motor_position=0.0 * log.position)
    assert with_motor_encoder([rest], DRIVE, lanes_of([rest]), NOISE, RATE) is None


@pytest.mark.long
def test_of_several_logs_some_may_have_one_encoder():
    logs = [moved(), moved(seconds=3.0).replace(motor_position=None)]
    setup = build_problem(logs, DRIVE, (), {})
    counts = np.asarray(setup.problem.lanes.motor.counts).sum(axis=1)
    assert counts[0] > 0.9 * len(logs[0].time)
    assert counts[1] == 0
    innovations = Innovations(coordinates(setup.free), SAMPLING)
    found, _ = evaluated(innovations, jnp.zeros(len(setup.free)), as_arrays(setup.problem))
    rows = np.asarray(found)[: 2 * setup.problem.lanes.position.size].reshape(2, -1, 2)
    assert np.all(np.isfinite(found))
    assert np.any(rows[0, :, 1])
    assert not np.any(rows[1, :, 1])


# --- what the fit finds

ROWS = (*CREEPING[2:], *SLOW[3:5], *MEDIUM[1:3], FAST[0], *STRONG[:2])
HELD = ("breakaway_gap", "stribeck_velocity", "bristle_damping", "constant_force")


@cache
def logged(*effects):
    """Both encoders of a simulated machine: the scale in steps of a micrometre, the motor's of ten nanometres."""
    axis = axis_of(noise=0.0, resolution=MOTOR_RESOLUTION)  # what the controller sees
    drive = replace(axis.drive, motor_encoder=DRIVE.motor_encoder, effects=effects)
    motion = concatenate([resting(0.1, RATE), *strokes(ROWS, RATE), resting(0.1, RATE)], "both")
    run = simulate_loop(drive, axis.controller, motion, sampling=axis.sampling, seed=1)
    run.require_ok()
    scale = RESOLUTION * np.round(run.position / RESOLUTION)
    return Log(
        "lap", time=run.time, position=scale, command=run.command, reference=run.reference,
        motor_position=run.motor_position + 0.123,
    )  # fmt: skip


def believed():
    """The machine with another mass, friction and bristle."""
    wrong = (120.0, 55.0, 2.5e7, 2.5e7)
    return eqx.tree_at(
        lambda drive: (
            drive.plant.mass,
            drive.friction.coulomb_screw.positive,
            drive.friction.bristle_stiffness.positive,
            drive.friction.bristle_stiffness.negative,
        ),
        DRIVE,
        wrong,
    )


@cache
def found_by(encoders, *effects):
    log = logged(*effects)
    log = log if encoders == 2 else log.replace(motor_position=None)
    return {one.name: one for one in identify([log], believed(), fixed=HELD, starts=1).estimates}


def width(one):
    return one.high - one.low


@pytest.mark.slow
def test_both_encoders_narrow_what_a_coarse_scale_leaves_and_hold_the_truth():
    both, scale = found_by(2), found_by(1)
    truth = {"mass": 100.0, "bristle_stiffness": 3.35e7, "delay": 0.0, "compliance": 0.0}
    for name, value in truth.items():
        assert both[name].status == "fitted"
        assert both[name].low <= value <= both[name].high, both[name]
    assert "compliance" not in scale
    for name, one in scale.items():
        if one.status == "fitted":
            assert width(both[name]) < width(one), name
    assert width(both["bristle_stiffness"]) < 0.5 * width(scale["bristle_stiffness"])


SCREW = Compliance(frequency=300.0)


@pytest.mark.slow
def test_a_motor_that_swings_on_its_screw_is_not_fitted_and_the_scale_is_to_the_last_bit_as_alone():
    log = logged(SCREW)
    both, alone = (identify([one], believed(), fixed=HELD, starts=1) for one in (log, log.replace(motor_position=None)))
    assert both.notes[0].startswith("the scale alone is fitted, and not the motor's encoder: with both a force of")
    assert both.notes[1:] == alone.notes
    assert both.estimates == alone.estimates
    assert np.array_equal(both.innovation, alone.innovation)
