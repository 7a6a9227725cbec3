"""What the diagnosis is made of: segments of a log, commands within a row, effects that a drive has."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.effects.actuator import ActuatorLag, LoopDelay
from diffdrive.effects.friction import FrictionDwell
from diffdrive.model.parameters import Sensor
from diffdrive.model.quantity import Directional
from diffdrive.motion.builders import from_array
from experiments.studies.control import Control
from experiments.studies.withheld.equations import FaultParameters, MachineStructure
from experiments.studies.withheld.machine import MachineInputs, run
from experiments.studies.withheld.score import read_key
from tests.support.sound_log import DRIVE, RATE, axis_of, simulate_log, two_sines
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.filter.segments import segments
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import is_complete, missing_evidence
from tuning.diagnosis.fits.intervals import parameters
from tuning.diagnosis.fits.reference_noise import lost_samples
from tuning.diagnosis.gap.gap import drive_of
from tuning.diagnosis.hypotheses.calibration import NAMES, TOLERANCE
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.catalogue import given as those_given
from tuning.diagnosis.hypotheses.model import Member, Model, effect_in_lanes, signals_along
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.screening import begin, joined
from tuning.diagnosis.selection.search import initial_trajectory, recalibrated
from tuning.identification.prediction import initial_velocity
from tuning.identification.problem import noise_floor


@pytest.mark.parametrize("delay", [0.0, 1.0, 1.3, 7.6])
def test_a_thinned_command_is_held_back_by_control_periods(delay):
    """What acts over each substep of the plant is exactly the mean of the held command, late by so many periods: a mean
    over whole control periods would spread what changes within one.
    """
    fast = axis_of(rate=10_000.0)
    log = simulate_log(fast, two_sines(0.3, 10_000.0))
    logs = logged_of(fast.drive, [log])
    effect = effect_in_lanes(LoopDelay, {"delay": np.array([delay / 5])}, logs.owner)
    acts = signals_along(logs, logs.drive, (effect,), initial_trajectory(logs))
    held = logs.sampling.plant_steps // 5  # substeps of a control period
    assert held > 1
    command, time = np.repeat(log.command, held), np.arange(held * len(log.time))
    late = np.interp(time - held * delay, time, command).reshape(-1, 5 * held)
    count = len(late)
    np.testing.assert_allclose(np.asarray(acts.force)[0, :count], late.mean(axis=1), atol=1e-9)
    np.testing.assert_allclose(np.asarray(acts.ripple)[0, :count], late - late.mean(axis=1, keepdims=True), atol=1e-9)


@pytest.mark.slow
def test_noise_in_a_fast_loop_does_not_pass_for_a_missing_force():
    """The command's noise shakes the table and lets its bristle creep, most of all at rest: thinned, it still does."""
    stiff = axis_of(kp=7.98e6, kd=15_960.0, noise=4e-8, rate=10_000.0)
    time = np.arange(24_000) / 10_000.0
    share = np.clip(time - 0.2, 0.0, 1.0) - np.clip(time - 1.4, 0.0, 1.0)  # rest, there, rest, back
    there_and_back = from_array(time, 0.02 * (share - np.sin(2 * np.pi * share) / (2 * np.pi)))
    logs = logged_of(stiff.drive, [simulate_log(stiff, there_and_back)])
    fitter = Fitter(logs)
    base = recalibrated(fitter, TOLERANCE)
    assert is_complete(fitter, base)
    even = logs._replace(lanes=logs.lanes._replace(period_commands=None))
    blind = recalibrated(Fitter(even), TOLERANCE)
    assert blind.process_noise[1] > 50.0 * base.process_noise[1]  # a sudden force that nobody exerts
    assert missing_evidence(Fitter(even), blind) > missing_evidence(fitter, base) + 10.0


@given(st.integers(20, 30_000), st.sampled_from([500.0, 1e3, 2e3, 1e4]))
def test_segments_hold_every_sample_once_and_a_lead_before(count, rate):
    found = segments(count, rate)
    signal = np.arange(count)
    np.testing.assert_array_equal(found.joined(found.cut(signal)), signal)
    assert np.all(np.diff(found.samples, axis=1) == 1)
    if len(found.samples) > 1:
        begins = np.searchsorted(found.segment, np.arange(1, len(found.samples)))
        assert np.all(found.place[begins] >= 0.09 * rate)


@pytest.mark.parametrize("rate", [500.0, 2e3, 1e4])
def test_the_velocity_at_the_first_sample_is_that_of_a_motion_that_accelerates(rate):
    time = np.arange(200) / rate
    position = jnp.asarray(0.3 + 0.02 * time + 0.5 * 15.0 * time**2)
    assert float(initial_velocity(position, rate)) == pytest.approx(0.02)
    noise = 5e-8 * np.random.default_rng(0).standard_normal((300, 200))
    assert np.std(initial_velocity(position + noise, rate)) < 2e-4  # well within what the filter grants it


@pytest.mark.long
def test_a_filter_of_a_fast_axis_is_nowhere_lost():
    """Segments that began with the mean velocity of their first 5 ms were 40 mm/s off at 15 m/s^2, and stayed so."""
    axis = axis_of(mass=20.0, kp=8e5, kd=2_400.0)
    free = Directional(15.0, 15.0)
    drive = dataclasses.replace(
        axis.drive,
        plant=dataclasses.replace(axis.drive.plant, damping=free),
        friction=dataclasses.replace(axis.drive.friction, viscous=free),
    )
    time = np.arange(6_000) / RATE
    there = from_array(time, 0.02 * (1.0 - np.cos(2.0 * np.pi * 4.3 * time)))
    fitter = Fitter(logged_of(drive, [simulate_log(dataclasses.replace(axis, drive=drive), there)]))
    base = recalibrated(fitter, 0.02)
    assert lost_samples(base) == 0
    assert is_complete(fitter, base)


@pytest.mark.long
def test_a_delay_that_is_claimed_and_not_there_is_found():
    log = simulate_log(DRIVE, two_sines())
    logs = logged_of(axis_of(delay=1).drive, [log])
    fitter = Fitter(logs)
    at = setting(logs.drive, logs.lanes, 1.0 / RATE)
    candidate = next(one for one in candidates(at) if one.name == "loop_delay")
    model = joined(Model(logs), candidate)
    theta = np.r_[np.zeros(len(NAMES)), candidate.parameters[0].standard(-0.5)]
    fit = fitter.fit(model, theta, None, initial_trajectory(logs))
    assert candidate.parameters[0].value(fit.theta[-1]) == pytest.approx(-1.0, abs=0.05)
    found = drive_of(fit, 0)  # less delay than none is no effect: the drive file claims less
    assert found.effects == ()
    assert found.actuator.delay_samples + float(found.actuator.delay_fraction) == pytest.approx(0.0, abs=0.05)


@pytest.mark.long
def test_a_fast_log_is_thinned_and_its_delay_still_counted_in_control_periods():
    fast = axis_of(rate=10_000.0, delay=3)
    log = simulate_log(fast, two_sines(2.0, 10_000.0))
    logs = logged_of(axis_of(rate=10_000.0).drive, [log])
    assert (logs.thinning, logs.sampling.rate, logs.control.rate) == (5, 2000.0, 10_000.0)
    assert float(logs.lanes.counts.sum()) == len(log.time) // 5
    np.testing.assert_array_equal(np.asarray(logs.lanes.position[0, :100]), log.position[:500:5])
    np.testing.assert_allclose(np.asarray(logs.lanes.command[0, 7]), log.command[35:40].mean())
    fitter = Fitter(logs)
    at = setting(logs.drive, logs.lanes, logs.sampling.period, logs.thinning)
    candidate = next(one for one in candidates(at) if one.name == "loop_delay")
    model = joined(Model(logs), candidate)
    fit = fitter.fit(model, np.r_[np.zeros(len(NAMES)), 0.3], None, initial_trajectory(logs))
    value, (low, high) = parameters(fit, 0)["delay"]
    assert value == pytest.approx(3.0, abs=0.02)
    assert low < value < high < 3.1
    assert is_complete(fitter, fit)
    assert float(drive_of(fit, 0).effects[0].delay) == pytest.approx(value)


@pytest.mark.long
def test_a_lag_shorter_than_a_thinned_sample_is_measured():
    fast = axis_of(kp=4e6, kd=12_000.0, noise=4e-8, rate=10_000.0)
    slow = dataclasses.replace(fast, drive=dataclasses.replace(fast.drive, effects=(ActuatorLag(3e-4),)))
    logs = logged_of(fast.drive, [simulate_log(slow, two_sines(2.0, 10_000.0))])
    fitter = Fitter(logs)
    at = setting(logs.drive, logs.lanes, logs.sampling.period, logs.thinning)
    candidate = next(one for one in candidates(at) if one.name == "actuator_lag")
    model = joined(Model(logs), candidate)
    values = {"time_constant": np.array([5e-4])}
    fit = fitter.fit(model, np.r_[np.zeros(len(NAMES)), begin(model, values)], None, initial_trajectory(logs))
    value, (low, high) = parameters(fit, 0)["time_constant"]
    assert low < value < high
    assert value == pytest.approx(3e-4, rel=0.03)
    assert is_complete(fitter, fit)


@pytest.mark.long
def test_the_withheld_machine_is_the_simulator_where_nothing_is_wrong():
    """Two programs, two integrators, one machine: without noise and on a fine scale they move alike."""
    plain = axis_of(resolution=None, noise=0.0)
    time = np.arange(600) / RATE
    motion = from_array(time, 1e-3 * (1 - np.cos(2 * np.pi * 5.0 * time)))
    ours = simulate_log(plain, motion)
    flat = np.zeros(600)
    told = MachineInputs(motion.position, flat, flat, flat, flat)
    gains = plain.controller.tracking.gains
    control = Control(0.0, float(gains.kp), float(gains.kd))
    position, command, _ = run(plain.drive, FaultParameters(), MachineStructure(), control, 1e-12, told, RATE)
    assert np.abs(position - ours.position).max() < 5e-9
    assert np.sqrt(np.mean((command - ours.command) ** 2)) < 0.01 * np.abs(command).max()


def test_a_key_without_sizes_says_what_is_clear(tmp_path):
    path = tmp_path / "key.json"
    path.write_text(
        '{"1": {"kind": "single", "visibility": "clear", "effects": [{"name": "cogging"}]},'
        ' "2": {"kind": "unknown", "visibility": "faint", "effects": [{"name": "chip"}]}}'
    )
    key = read_key(path)
    assert [key[name]["effects"][0]["size"] for name in "12"] == [3.0, 0.0]
    assert [key[name]["effects"][0]["outside"] for name in "12"] == [False, True]


def test_less_than_no_delay_is_none_to_the_simulator():
    assert LoopDelay(-0.5).step((0.0,) * 8, jnp.asarray(3.0), 1e-3)[1].mean == 3.0


@pytest.mark.long
@pytest.mark.parametrize(("rate", "thinning"), [(4000.0, 2), (8000.0, 4), (10_000.0, 5), (3000.0, 1), (500.0, 1)])
@pytest.mark.parametrize("off", [0.0, -1e-6, 1e-6])
def test_a_clock_that_is_a_little_off_thins_a_log_as_a_right_one_does(rate, thinning, off):
    log = simulate_log(axis_of(rate=rate), two_sines(1.0, rate))
    log = dataclasses.replace(log, time=log.time / (1.0 + off))
    assert logged_of(DRIVE.drive, [log]).thinning == thinning


def test_a_given_effect_makes_no_hypothesis_coarse():
    logs = logged_of(DRIVE.drive, [simulate_log(DRIVE, two_sines(1.0))])
    at = setting(logs.drive, logs.lanes, logs.sampling.period)
    dwell = next(one for one in candidates(at) if one.name == "friction_dwell")
    (known,) = those_given([FrictionDwell()], at)
    assert not Model(logs, (Member(*known),)).coarse
    assert joined(Model(logs, (Member(*known),)), dwell).coarse


@pytest.mark.parametrize("rate", [500.0, 1000.0, 5000.0])
def test_the_noise_of_a_position_is_seen_through_its_motion(rate):
    """Of 50 nm under a sine of 5 Hz and 3 mm, which shows in third differences at 500 Hz."""
    time = np.arange(round(6.0 * rate)) / rate
    position = 3e-3 * np.sin(2 * np.pi * 5.0 * time) + 5e-8 * np.random.default_rng(0).standard_normal(len(time))
    lanes = SimpleNamespace(position=position[None], counts=np.ones((1, len(time))))
    silent = dataclasses.replace(DRIVE.drive, sensor=Sensor())
    assert noise_floor(silent, lanes, rate) == pytest.approx(5e-8, rel=0.08)
