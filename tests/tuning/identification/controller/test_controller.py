"""Gains of a cascade from logs, against a naive loop of its own that is no part of the package."""

import json
from dataclasses import replace

import numpy as np
import pytest

import diffdrive as dd
import tuning
from diffdrive.axis import Sampling
from diffdrive.controllers import Cascade, UnknownController
from diffdrive.errors import LogError, ParameterError, ResultError
from diffdrive.logs import Log
from diffdrive.model.trace import Trace
from experiments.studies.controller_study import NaiveCascade, study
from experiments.studies.data_folder import find_data
from tests.support.sound_log import axis_of, simulate_log, two_sines
from tuning.identification.controller.findings import controller_findings
from tuning.identification.controller.law import Law, Reading, coefficients
from tuning.identification.controller.moments import moments
from tuning.identification.controller.readings import fit_log
from tuning.identification.controller.signals import HELD_ROWS, interpolation, pieces, snapshots

TRACE = NaiveCascade()  # snapshots of every fourth sample
SECONDS = 4.0
FOREIGN = find_data("bench-foreign", "key.json")


@pytest.fixture(scope="module")
def trace():
    return TRACE.log(SECONDS, seed=1, name="before")


@pytest.fixture(scope="module")
def estimate(trace):
    return tuning.identify_controller(None, trace)


@pytest.fixture(scope="module")
def every_sample():
    cascade = replace(TRACE, ratio=1, rate=2000.0, velocity_feedforward=1.0, acceleration_feedforward=400.0)
    return cascade, tuning.identify_controller(None, cascade.log(2.0, seed=2), control_rate=cascade.rate)


def relative(estimate, cascade, name):
    return estimate.gain(name).value / getattr(cascade, name) - 1.0


@pytest.mark.parametrize("name", ["kp", "kv", "reset_time"])
def test_gains_of_a_trace_slower_than_the_loop_are_within_two_per_cent_and_their_intervals(estimate, name):
    assert abs(relative(estimate, TRACE, name)) < 0.02
    low, high = estimate.interval(name)
    assert low <= getattr(TRACE, name) <= high
    assert estimate.gain(name).determined


def test_gains_of_every_sample_are_exact_where_both_loops_are_equally_fast():
    cascade = replace(TRACE, ratio=1, rate=2000.0, kp=60.0, reset_time=1.0 / 60.0, velocity_samples=4)
    found = tuning.identify_controller(None, cascade.log(2.0, seed=9), control_rate=cascade.rate)
    assert found.logs[0].reading is Reading.EVERY_SAMPLE
    for name in ("kp", "kv", "reset_time"):
        assert abs(relative(found, cascade, name)) < 2e-3


def test_feed_forwards_that_are_not_there_are_none(estimate):
    for name in ("velocity_feedforward", "acceleration_feedforward"):
        low, high = estimate.interval(name)
        assert low <= 0.0 <= high
        assert not estimate.gain(name).determined


def test_a_trace_is_read_as_snapshots_whose_velocity_window_is_found(estimate):
    (log,) = estimate.logs
    assert log.reading is Reading.SAME_INSTANT
    assert log.window == pytest.approx(2 / 4000.0, rel=0.1)


@pytest.mark.parametrize("name", ["kp", "kv", "reset_time", "velocity_feedforward"])
def test_gains_are_exact_where_every_sample_is_logged(every_sample, name):
    cascade, estimate = every_sample
    assert estimate.logs[0].reading is Reading.EVERY_SAMPLE
    assert abs(relative(estimate, cascade, name)) < 2e-3


@pytest.mark.parametrize("seed", [10, 11])
def test_of_a_command_without_noise_no_rounding_chooses_the_reading(seed):
    """With free coefficients two samples explain what one does, and rounding alone says which of them leaves less."""
    found = fit_log(simulate_log(axis_of(), two_sines(4.0), seed=seed))
    assert found.reading is Reading.EVERY_SAMPLE
    assert found.unexplained < 1e-13
    assert np.exp(found.law.log_gain) == pytest.approx(12_170.0, rel=1e-9)
    assert np.exp(found.law.log_kp) == pytest.approx(3.99e6 / 12_170.0, rel=1e-9)


def test_acceleration_feed_forward_is_found_where_every_sample_is_logged(every_sample):
    cascade, estimate = every_sample
    assert abs(relative(estimate, cascade, "acceleration_feedforward")) < 0.02


def test_a_changed_position_gain_is_one_sentence(trace):
    today = replace(TRACE, kp=0.9 * TRACE.kp).log(SECONDS, seed=3, name="today")
    both = tuning.identify_controller(None, [today, trace])
    assert [one.sentence for one in both.differences] == ["K_v is 45 1/s in today, 50 1/s in before"]
    assert both.status.code == "different controllers"
    with pytest.raises(ResultError, match="differ"):
        both.require_ok()


def test_the_same_controller_is_not_said_to_differ_and_is_joined(trace):
    both = tuning.identify_controller(None, [trace, TRACE.log(SECONDS, seed=4, name="today")])
    assert both.differences == ()
    assert both.status.ok
    # not of the velocity gain: what is not known of it is mostly the period of the controller, the same in both
    assert np.diff(both.interval("kp")) < max(one.gain("kp").high - one.gain("kp").low for one in both.logs)


def test_a_log_is_compared_with_the_controller_of_the_axis(trace):
    axis = dd.paper_axis(controller="cascade").with_gains(kp=90.0, kv=1e5, ki=1e5 / 0.015)
    controller = replace(axis.controller, velocity_feedforward=0.0)
    found = tuning.identify_controller(replace(axis, controller=controller), trace).differences
    assert [one.sentence for one in found] == ["K_v is 50 1/s in before, 90 1/s in the drive file"]


def test_gains_scale_with_the_unit_of_force_and_do_not_know_where_zero_is(trace, estimate):
    moved = trace.replace(command=10.0 * trace.command, position=trace.position + 1.0, reference=trace.reference + 1.0)
    other = tuning.identify_controller(None, moved)
    assert other.gain("kv").value == pytest.approx(10.0 * estimate.gain("kv").value, rel=1e-3)
    assert other.gain("kp").value == pytest.approx(estimate.gain("kp").value, rel=1e-3)


def test_results_print_and_save(estimate, tmp_path):
    assert "K_v" in repr(estimate)
    assert all(len(line) <= 100 for line in estimate.summary().splitlines()[1:9])
    document = json.loads(estimate.save(tmp_path).read_text())
    assert document["schema"] == "controller/1"
    assert document["gains"][0]["name"] == "kp"
    with pytest.raises(ParameterError, match="known: kp, kv"):
        estimate.gain("kd")


def test_logs_that_show_no_controller_are_refused(trace):
    with pytest.raises(LogError, match="before: reference: is missing"):
        tuning.identify_controller(None, trace.replace(reference=None))
    short = Log("short", trace.time[:50], trace.position[:50], trace.command[:50], trace.reference[:50])
    with pytest.raises(LogError, match="short: has no stretch"):
        tuning.identify_controller(None, short)
    with pytest.raises(LogError, match="no log is given"):
        tuning.identify_controller(None, [])
    with pytest.raises(ParameterError, match="control_rate"):
        tuning.identify_controller(None, trace, control_rate=0.0)


def test_a_clipped_command_ends_a_piece(trace):
    command = np.clip(trace.command, -400.0, 400.0)
    kept = list(pieces(trace.replace(command=command)))
    assert len(kept) > 1
    held = np.flatnonzero(np.convolve(np.abs(command) == 400.0, np.ones(HELD_ROWS), "valid") == HELD_ROWS)
    assert not any(piece.start <= row < piece.stop for piece in kept for row in held)


def test_a_quartic_is_interpolated_exactly():
    rows = np.arange(-2, 3)
    polynomial = np.polynomial.Polynomial([0.3, -1.0, 0.5, 0.2, -0.1])
    assert interpolation(0.37) @ polynomial(rows) == pytest.approx(polynomial(0.37), abs=1e-12)


@pytest.mark.parametrize("late", [0.0, 0.25])
def test_the_law_of_snapshots_holds_on_polynomials_without_noise(late):
    # where the position is a cubic and the reference a quadratic, each signal and the command are known in closed form
    period, law = 1e-3, Law(np.log(40.0), 0.01, np.log(2e4), 50.0, 1e-3, late=late, window=0.5)
    time = period * np.arange(200)
    r = np.polynomial.Polynomial([0.0, 0.1, 0.4])
    y = np.polynomial.Polynomial([-1e-3, 0.08, 0.3, -0.7])
    window = 0.5 * period
    mean_speed = (y(time) - y(time - window)) / window
    mean = (y.integ()(time) - y.integ()(time - window)) / window
    fed = 1.0 - 40.0 * 0.01
    w = 40.0 * (r(time) - y(time)) + fed * r.deriv()(time - late * period) - mean_speed
    iw = 40.0 * (r - y).integ()(time) + fed * r(time - late * period) - mean
    command = 2e4 * (w + 50.0 * iw + 1e-3 * r.deriv(2)(time))
    log = Log("cubic", time, y(time), command, r(time))
    equation = snapshots(log, slice(0, 200), 0, noise=0.0)
    theta = coefficients(law, period, Reading.SAME_INSTANT)
    for x, u in [(equation.regressors, equation.commands), equation.conditions[0][1:3]]:
        assert np.max(np.abs(u[:, 2] - x @ theta)) < 1e-7 * np.max(np.abs(command))


def test_blocks_add_up_to_the_whole(trace):
    equation = snapshots(trace, slice(0, len(trace.time)), 0, noise=0.0)
    sums = moments([equation])
    whole = np.concatenate([one.instruments.T @ one.regressors for one in equation.conditions])
    assert sums.regressors.sum(axis=0) == pytest.approx(whole, rel=1e-9, abs=1e-12)


def test_what_noise_adds_to_the_sums_of_motion_is_taken_away():
    # a position of noise alone, and a command of that noise: nothing is left of the sums, but for chance
    rng, noise, gain, rows = np.random.default_rng(6), 1e-7, 1e5, 40_000
    y = noise * rng.standard_normal(rows)
    log = Log("noise", 1e-3 * np.arange(rows), y, gain * y, 0.0 * y)
    motion = snapshots(log, slice(0, rows), 0, noise).conditions[0]
    derivatives = [0, 5, 6, 7]  # not the integral, whose noise is a random walk
    sums = motion.instruments.T @ motion.regressors / len(y) + motion.excess
    size = np.sqrt(np.mean(motion.instruments**2, axis=0))[derivatives]
    assert np.max(np.abs(sums[np.ix_(derivatives, derivatives)] / np.outer(size, size))) < 0.05
    command = motion.instruments.T @ motion.commands[:, 2] / len(y)
    assert np.max(np.abs(motion.excess[derivatives, -1] * gain - command[derivatives]) / size) < 0.05 * gain * noise


def test_an_axis_that_stands_does_not_show_the_window_of_its_velocity():
    # a count that flickers now and then is one and the same for many samples: no noise of its own in each
    rng = np.random.default_rng(7)
    y = 1e-6 * np.round(0.3 * rng.standard_normal(4000) + 0.3)
    log = Log("standing", 1e-3 * np.arange(4000), y, 1e5 * y, 0.0 * y)
    quiet = snapshots(log, slice(0, 4000), 0, 1e-7).conditions[1]
    assert not quiet.instruments.any()


def test_gains_that_can_change_places_have_intervals_that_say_so():
    cascade = NaiveCascade(kp=60.0, reset_time=1.0 / 60.0, velocity_feedforward=1.0, resolution=2e-7)
    found = tuning.identify_controller(None, cascade.log(SECONDS, seed=8), control_rate=cascade.rate)
    for name in ("kp", "kv", "reset_time"):
        low, high = found.interval(name)
        assert low <= getattr(cascade, name) <= high
    low, high = found.interval("kp")
    assert high > 1.02 * low


def test_a_reference_differenced_backwards_does_not_pass_for_another_position_gain():
    """Its speed is half a sample late: read as that of the row, K_v seemed 4 % larger, and surely so."""
    cascade = replace(TRACE, velocity_feedforward=0.9, backward=True)
    found = tuning.identify_controller(None, cascade.log(SECONDS, seed=8), control_rate=cascade.rate)
    for name in ("kp", "kv", "reset_time"):
        low, high = found.interval(name)
        assert low <= getattr(cascade, name) <= high
    low, high = found.interval("kv")
    assert high < 1.05 * low


def traced_axis():
    """An axis of 4 kHz with a trace of every fourth sample, whose controller is not known."""
    axis = dd.paper_axis(controller="cascade")
    return replace(axis, controller=UnknownController(), sampling=Sampling(4000.0), trace=Trace(rate=1000.0))


def test_the_found_cascade_takes_the_place_of_an_unknown_controller(trace, tmp_path):
    found = tuning.identify_controller(traced_axis(), trace)
    controller = found.axis.controller
    assert controller.kp == pytest.approx(TRACE.kp, rel=0.02)
    assert controller.kv == pytest.approx(TRACE.kv, rel=0.02)
    assert controller.reset_time == pytest.approx(TRACE.reset_time, rel=0.02)
    assert controller.velocity_samples == TRACE.velocity_samples
    assert controller.velocity_feedforward == 0.0
    assert controller.feedforward is None
    found.axis.write(tmp_path / "controller.toml")
    assert dd.read_axis(tmp_path / "controller.toml").controller.kp == pytest.approx(controller.kp)


def test_without_the_rate_of_the_controller_no_axis_is_made(trace):
    axis = replace(traced_axis(), sampling=Sampling(1000.0), trace=Trace())
    assert tuning.identify_controller(axis, trace).axis is None


def test_checks_say_where_a_log_has_another_controller(trace):
    today = replace(TRACE, kp=0.9 * TRACE.kp).log(SECONDS, seed=3, name="today")
    ((log, finding),) = controller_findings(traced_axis(), [trace, today])
    assert log == "today"
    assert finding.severity == "warning"
    assert finding.message == "K_v is 50 1/s in before, 45 1/s in today"
    ((log, _),) = controller_findings(traced_axis(), [today], before=[trace])
    assert log == "today"


def test_checks_say_where_a_log_has_another_controller_than_the_drive_file(trace):
    cascade = Cascade(kp=60.0, kv=TRACE.kv, reset_time=TRACE.reset_time, velocity_samples=2)
    ((log, finding),) = controller_findings(replace(traced_axis(), controller=cascade), [trace])
    assert (log, finding.message) == ("before", "K_v is 50 1/s in before, 60 1/s in the drive file")
    filtered = replace(cascade, velocity_filter_time=1e-3)
    assert not list(controller_findings(replace(traced_axis(), controller=filtered), [trace]))


def test_checks_say_nothing_of_one_controller_and_of_no_reference(trace):
    again = TRACE.log(SECONDS, seed=4, name="again")
    assert not list(controller_findings(traced_axis(), [trace, again]))
    assert not list(controller_findings(traced_axis(), [trace.replace(reference=None)]))


def test_a_command_that_no_cascade_explains_is_compared_with_none(trace):
    time = trace.time
    odd = trace.replace(command=trace.command + 100.0 * np.sin(40.0 * time + 3.0 * np.sin(5.0 * time)))
    today = replace(TRACE, kp=0.5 * TRACE.kp).log(SECONDS, seed=3, name="today")
    found = tuning.identify_controller(None, [odd, today])
    assert found.differences == ()
    assert any("a cascade does not explain the command" in note for note in found.notes)


@pytest.mark.long
def test_a_command_of_another_instant_leaves_wider_intervals_that_hold():
    fit = fit_log(replace(TRACE, late=2 / 4000.0).log(6.0, seed=5))
    assert fit.reading is Reading.OWN_INSTANT
    deviation = np.sqrt(fit.mixture[0].covariance[0, 0])
    assert abs(fit.law.log_kp - np.log(TRACE.kp)) < 3.0 * deviation


@pytest.mark.slow
def test_random_cascades():
    rows = list(study(50))
    covered = []
    for row in rows:
        for name in ("kp", "kv", "reset_time"):
            error, low, high = row.relative(name)
            covered.append(low <= 0.0 <= high)
            assert abs(error) < 0.02 or high - low > 0.04
        assert all(found for found, due in zip(row.found, row.permitted, strict=True) if due)
    assert 0.9 <= np.mean(covered) <= 0.99
    assert not any(row.alarm for row in rows)


@pytest.mark.slow
@pytest.mark.skipif(FOREIGN is None, reason="needs shared/data/bench-foreign beside the checkout")
@pytest.mark.parametrize("case", ["06", "08", "11", "14"])
def test_traces_of_foreign_machines(case):
    _, kp, kv, ki, forward, _ = json.loads((FOREIGN / "key.json").read_text())[case]["controller"]
    logs = [FOREIGN / case / f"healthy-{k}.parquet" for k in (1, 2)]
    found = tuning.identify_controller(None, logs)
    assert found.status.ok
    assert found.gain("kp").value == pytest.approx(kp, rel=0.05)
    assert found.gain("kv").value == pytest.approx(kv, rel=0.05)
    assert found.gain("reset_time").value == pytest.approx(kv / ki, rel=0.05)
    assert found.gain("velocity_feedforward").value == pytest.approx(forward, abs=0.01)
