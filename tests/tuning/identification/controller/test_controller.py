"""Gains of a cascade from logs, against a naive loop of its own that is no part of the package."""

import json
from dataclasses import replace

import numpy as np
import pytest

import diffdrive as dd
import tuning
from diffdrive.errors import LogError, ParameterError, ResultError
from diffdrive.logs import Log
from experiments.studies.controller_study import NaiveCascade, study
from experiments.studies.data_folder import find_data
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


def test_the_same_controller_is_not_said_to_differ_and_is_joined(trace, estimate):
    both = tuning.identify_controller(None, [trace, TRACE.log(SECONDS, seed=4, name="today")])
    assert both.differences == ()
    assert both.status.ok
    assert np.diff(both.interval("kv")) < np.diff(estimate.interval("kv"))


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


def test_the_law_of_snapshots_holds_on_polynomials_without_noise():
    # where position and reference are cubics, each signal and the command are known in closed form
    period, law = 1e-3, Law(np.log(40.0), 0.01, np.log(2e4), 50.0, 1e-3, 0.5)
    time = period * np.arange(200)
    r = np.polynomial.Polynomial([0.0, 0.1, 0.4, -1.0])
    y = np.polynomial.Polynomial([-1e-3, 0.08, 0.3, -0.7])
    window = 0.5 * period
    mean_speed = (y(time) - y(time - window)) / window
    mean = (y.integ()(time) - y.integ()(time - window)) / window
    w = 40.0 * (r(time) - y(time) - 0.01 * r.deriv()(time)) + r.deriv()(time) - mean_speed
    error = (r - y).integ()(time)
    iw = 40.0 * (error - 0.01 * r(time)) + r(time) - mean
    command = 2e4 * (w + 50.0 * iw + 1e-3 * r.deriv(2)(time))
    log = Log("cubic", time, y(time), command, r(time))
    x, _, u = snapshots(log, slice(0, 200), 0)
    left = u[:, 2] - x @ coefficients(law, period, Reading.SAME_INSTANT)
    assert np.max(np.abs(left)) < 1e-7 * np.max(np.abs(command))


def test_blocks_add_up_to_the_whole(trace):
    equation = snapshots(trace, slice(0, len(trace.time)), 0)
    sums = moments([equation])
    whole = equation.instruments.T @ equation.regressors
    assert sums.regressors.sum(axis=0) == pytest.approx(whole, rel=1e-9, abs=1e-12)


@pytest.mark.long
def test_a_command_of_another_instant_leaves_wider_intervals_that_hold():
    fit = fit_log(replace(TRACE, late=2 / 4000.0).log(6.0, seed=5))
    assert fit.reading is Reading.OWN_INSTANT
    deviation = np.sqrt(fit.covariance[0, 0])
    assert abs(fit.law.log_kp - np.log(TRACE.kp)) < 3.0 * deviation


@pytest.mark.slow
def test_random_cascades():
    rows = list(study(50))
    wrong = [row for row in rows if any(abs(row.relative(name)[0]) > 0.02 for name in ("kp", "kv", "reset_time"))]
    shown = [row for row in wrong if row.relative("kp")[2] - row.relative("kp")[1] < 0.04]
    assert len(shown) <= 2
    assert sum(bool(row.alarm) for row in rows) <= 2


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
