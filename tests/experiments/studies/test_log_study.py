"""The study of the log checks: its logs show their fault, its truth is true, and its scorer can tell."""

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.controllers import Reference
from diffdrive.logs.checks.examine import Finding
from diffdrive.logs.checks.finding import CAUSES
from diffdrive.numerics.arrays import as_arrays
from diffdrive.runtime import configure
from experiments.reports.report import Report
from experiments.studies.log_study.controllers import WEIGHTS, replayed_command
from experiments.studies.log_study.drives import study_drives
from experiments.studies.log_study.fault import LogFault
from experiments.studies.log_study.machines import lost_motion, play_side
from experiments.studies.log_study.repair_check import differences
from experiments.studies.log_study.score import interval, score_fault
from experiments.studies.log_study.sound import motions, sound_log
from experiments.studies.log_study.study import FAULTS, draw_faulty_logs, log_study
from experiments.studies.log_study.timing import delayed
from experiments.studies.log_study.values import averaged

configure()

TABLE = study_drives()[0]
CASE = sound_log(TABLE, np.random.default_rng([9, 0]))
ON_THE_TABLE = [draw for draw in FAULTS if draw.applies(TABLE)]


def finding(cause, channel="position", *, severity="fatal", rivals=(), repair=None):
    return Finding(severity, channel, "what", "how", cause, rivals, repair)


def fault_of(draw, seed=0):
    rng = np.random.default_rng(seed)
    return next(filter(None, (draw.draw(CASE, rng) for _ in range(50))))


def truthful(fault):
    """A check that knows."""

    def examine(log, description):
        if log is not fault.log:
            return []
        mend = None if fault.undo is None else SimpleNamespace(apply=fault.undo)
        channel = fault.channels[0] if fault.channels else "time"
        return [finding(fault.causes[0], channel, rivals=fault.rivals, repair=mend)]

    return examine


@pytest.mark.parametrize("draw", ON_THE_TABLE, ids=lambda draw: draw.name)
def test_a_fault_is_undone_and_a_right_answer_scores(draw):
    for seed in range(3):
        fault = fault_of(draw, seed)
        if fault.undo is not None:
            assert differences(fault.log, fault, TABLE.resolution) != []
            assert differences(fault.undo(fault.log), fault, TABLE.resolution) == []
        score = score_fault(fault, TABLE.axis, TABLE.resolution, truthful(fault))
        assert {*fault.causes, *fault.rivals} <= set(CAUSES)
        assert (score.first, score.named, score.rivals, score.wrong_repair) == (True, True, True, "")
        assert score.repaired == (fault.undo is not None)


@pytest.mark.parametrize("draw", ON_THE_TABLE, ids=lambda draw: draw.name)
def test_a_mend_of_something_else_is_wrong(draw):
    fault = fault_of(draw)
    half = SimpleNamespace(apply=lambda log: dataclasses.replace(log, command=0.5 * log.command))

    def examine(log, description):
        return [finding("gain", "command", repair=half)] if log is fault.log else []

    score = score_fault(fault, TABLE.axis, TABLE.resolution, examine)
    assert not score.repaired
    assert "gain" in score.summary
    assert "command" in score.wrong_repair.partition(" after: ")[0]


def test_silence_and_a_wrong_cause_score_nothing():
    fault = fault_of(ON_THE_TABLE[0])
    silent = score_fault(fault, TABLE.axis, TABLE.resolution, lambda log, description: [])
    assert (silent.first, silent.named, silent.repaired, silent.wrong_repair) == (False, False, False, "")
    wrong = score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: [finding("gain", rivals=("swapped",))])
    assert (wrong.first, wrong.named) == (False, True)


def test_the_first_finding_that_is_more_than_a_note_counts():
    fault = fault_of(ON_THE_TABLE[0])
    findings = [finding("gain", severity="note"), finding("swapped", severity="warning"), finding("offset")]
    assert score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: findings).first
    assert score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: findings[:1]).summary == "gain (position)"
    assert not score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: [finding("swapped", "command")]).first


def test_rivals_that_nobody_can_rule_out_must_be_named():
    fault = dataclasses.replace(fault_of(ON_THE_TABLE[0]), rivals=("other machine",))
    sure = score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: [finding("swapped")])
    open_minded = score_fault(
        fault, TABLE.axis, TABLE.resolution, lambda *_: [finding("swapped", rivals=("other machine",))]
    )
    assert (sure.first, sure.rivals) == (True, False)
    assert (open_minded.first, open_minded.rivals) == (True, True)


def test_mends_are_applied_one_after_the_other_and_at_most_three():
    true = CASE.log
    fault = LogFault(dataclasses.replace(true, command=8 * true.command), true, "x 8", ("gain",))
    half = SimpleNamespace(apply=lambda log: dataclasses.replace(log, command=0.5 * log.command))
    score = score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: [finding("gain", "command", repair=half)])
    assert score.repaired
    fault = dataclasses.replace(fault, log=dataclasses.replace(true, command=16 * true.command), undo=lambda log: true)
    score = score_fault(fault, TABLE.axis, TABLE.resolution, lambda *_: [finding("gain", "command", repair=half)])
    assert score.wrong_repair.startswith("command")


BOTH = ("position", "reference")


def unfaulted(**channels):
    return LogFault(CASE.log, CASE.log, "", ("gain",)), dataclasses.replace(CASE.log, **channels)


def test_a_common_zero_and_a_common_delay_are_no_difference():
    log = CASE.log
    fault, moved = unfaulted(reference=log.reference + 0.01, position=log.position + 0.01)
    assert differences(moved, fault, TABLE.resolution) == []
    late = {name: delayed(getattr(log, name), 3) for name in ("reference", "position", "command")}
    fault, moved = unfaulted(**late)
    assert differences(moved, fault, TABLE.resolution) == []


@pytest.mark.parametrize(
    ("channels", "wrong"),
    [
        ({"command": lambda log: 1.05 * log.command}, "command"),
        ({"reference": lambda log: log.reference + 1e-5}, "following error"),
        ({"position": lambda log: 1.01 * log.position, "reference": lambda log: 1.01 * log.reference}, "position"),
        ({"position": lambda log: delayed(log.position, 1)}, "following error"),
        ({name: lambda log, n=name: delayed(getattr(log, n), 0.5) for name in BOTH}, "delay between channels"),
        ({"time": lambda log: 1.001 * log.time}, "time"),
    ],
)
def test_what_would_give_another_drive_is_a_difference(channels, wrong):
    fault, changed = unfaulted(**{name: make(CASE.log) for name, make in channels.items()})
    assert wrong in differences(changed, fault, TABLE.resolution)


def test_lost_motion_follows_the_direction_and_keeps_it_at_rest():
    made = motions(TABLE)["strokes"](np.random.default_rng(1))
    where = play_side(made, TABLE.rate)
    fast = np.abs(made.velocity) > 0.5 * np.max(np.abs(made.velocity))
    np.testing.assert_array_equal(where[fast], np.sign(made.velocity[fast]))
    began = np.argmax(fast)
    still = np.abs(made.velocity[began:]) < 1e-9
    assert still.any()
    assert np.mean(np.abs(where[began:][still]) == 1.0) > 0.8
    case = dataclasses.replace(CASE, log=dataclasses.replace(CASE.log, motor_position=CASE.log.position))
    fault = lost_motion(case, np.random.default_rng(0))
    play = np.ptp(fault.log.motor_position - fault.log.position)
    assert fault.amount == f"{1e6 * play:.3g} um"
    assert differences(fault.log, fault, TABLE.resolution) == []


def test_the_fitted_velocity_is_the_slope_of_a_line():
    at = np.array([0.0, -1.0, -2.0, -3.0])
    samples = np.random.default_rng(0).normal(size=4)
    assert np.dot(WEIGHTS, samples) == pytest.approx(np.polyfit(at, samples, 1)[0])


def test_what_a_controller_would_have_commanded_is_what_it_did():
    made, log = CASE.motion, CASE.log
    reference = Reference(made.position, made.velocity, made.acceleration)
    arrays = as_arrays((TABLE.axis.controller, reference, log.position, log.command))
    np.testing.assert_allclose(
        replayed_command(*arrays, 1.0 / TABLE.rate), log.command, atol=1e-6 * np.std(log.command)
    )


def test_trailing_means_hold_the_past_and_centred_ones_both_sides():
    ramp = np.arange(50.0)
    np.testing.assert_allclose(averaged(ramp, 5, trailing=False)[10:40], ramp[10:40])
    np.testing.assert_allclose(averaged(ramp, 5, trailing=True)[10:40], ramp[10:40] - 2)


def test_the_interval_is_wilsons():
    assert interval(8, 10) == pytest.approx((0.4902, 0.9433), abs=1e-4)
    assert interval(0, 20)[1] == pytest.approx(0.1611, abs=1e-4)


def test_a_seed_gives_the_same_cases():
    one, other = ([*draw_faulty_logs(6, 3, [TABLE])] for _ in range(2))
    assert [(a.kind, a.fault.amount) for a in one] == [(b.kind, b.fault.amount) for b in other]
    assert all(np.array_equal(a.fault.log.command, b.fault.log.command) for a, b in zip(one, other, strict=True))
    assert [a.fault.amount for a in draw_faulty_logs(6, 4, [TABLE])] != [a.fault.amount for a in one]


@pytest.mark.long
def test_the_report_counts(tmp_path):
    def examine(log, description):
        return [finding("swapped", "reference", severity="warning")] if log.name in motions(TABLE) else []

    def together(logs, description):
        return [finding("machines differ", "command")] if np.std(logs[0].command) > np.std(logs[1].command) else []

    with Report("study", tmp_path) as report:
        log_study(report, cases=31, healthy=4, pairs=6, seed=2, examine=examine, together=together, axes=[TABLE])
    data = json.loads((tmp_path / "result.json").read_text())
    kinds = data["tables"]["by_fault"]["rows"]
    assert sum(row[1] for row in kinds) == data["faulty_logs"]["logs"] == len(data["tables"]["cases"]["rows"])
    assert sum(row[2] for row in kinds) == data["faulty_logs"]["named_first"] == 1
    assert data["faulty_logs"]["wrong_mends"] == 0
    assert data["notes"][-3:] == report.page.conclusions
    assert data["notes"][-3].endswith(" of them first; 0 repairs would be wrong.")
    assert data["sound_logs"]["warning_at_worst"] == 4
    assert data["sound_logs"]["nothing"] == 0
    pairs = data["tables"]["pairs"]["rows"]
    assert data["pairs_of_logs"]["mixed"] == sum(row[4] != "none" for row in pairs) > 0
    assert data["pairs_of_logs"]["found"] + data["pairs_of_logs"]["false_alarms"] == sum(
        row[5] == "yes" for row in pairs
    )
    assert (tmp_path / "by_fault.csv").exists()


def test_ten_axes_of_different_kinds():
    axes = study_drives()
    assert len({axis.name for axis in axes}) == len(axes) >= 5
    assert {axis.kind for axis in axes} >= {"pd", "pd+fc+le", "pd+ff+dob", "cascade", "unknown"}
    for draw in FAULTS:
        assert any(draw.applies(axis) for axis in axes)
