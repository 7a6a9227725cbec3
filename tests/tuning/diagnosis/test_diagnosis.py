"""The diagnosis from end to end, and what it rests on: coverage, places, floors, scores."""

import dataclasses
import json
from functools import cache
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

from diffdrive.axis_file.drive_file import read_axis, write_axis
from diffdrive.effects.forces import ConstantForce
from diffdrive.logs import write_log
from diffdrive.loop.simulate import simulate_loop
from diffdrive.motion.builders import from_array
from experiments.reports.diagnosis.diagnosis import diagnose_logs
from experiments.reports.diagnosis.files import write_reference
from experiments.reports.report import Report
from experiments.studies.withheld.score import score
from tests.support.sound_log import DRIVE, RATE, axis_of, simulate_log, two_sines
from tuning.diagnosis.diagnose import _credible, _within, diagnose, logged_of
from tuning.diagnosis.filter.effect_signals import Trajectory
from tuning.diagnosis.gap.gap import ForceGap
from tuning.diagnosis.gap.lines import lines_in_position, lines_in_time
from tuning.diagnosis.gap.where import localise
from tuning.diagnosis.hypotheses.calibration import LOGARITHMS, NAMES, calibrated, tolerated
from tuning.diagnosis.hypotheses.excitation import excitation_deficits
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.judgement.verdict import Belief, Verdict
from tuning.diagnosis.levels import STRAINED
from tuning.diagnosis.next_experiment import next_experiment
from tuning.diagnosis.selection.starting_points import _window
from tuning.diagnosis.workflow import augmented_drive
from tuning.experiment_design.next_motion import candidates
from tuning.identification.shown_motion import ExcitationDeficit

# how far the machine is from its file, but for constant force and delay
OFF = np.append(np.random.default_rng(8).uniform(-0.02, 0.02, LOGARITHMS), [0.0, 0.0])


@cache
def log_of(*effects):
    machine = jax.tree.map(float, calibrated(DRIVE.drive, jnp.asarray(OFF)))
    return simulate_log(dataclasses.replace(DRIVE, drive=dataclasses.replace(machine, effects=effects)), two_sines())


@pytest.fixture(scope="module")
def sound():
    return diagnose(DRIVE.drive, DRIVE.controller, [log_of()])


@pytest.fixture(scope="module")
def tilted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tilted")
    write_log(folder / "lap.parquet", log_of(ConstantForce(6.0)))
    write_axis(folder / "drive.toml", DRIVE)
    told = diagnose_logs([folder / "lap.parquet"], folder / "drive.toml", folder / "out")
    return folder / "out", told


@pytest.mark.long
def test_a_sound_machine_has_no_effect_and_no_gap_beyond_its_floor(sound):
    assert sound.verdict.verdict == "none"
    recalibrated = sound.comparisons[1]
    assert recalibrated.force.rms == pytest.approx(sound.floor, rel=0.08)
    assert recalibrated.loop.position_rms == pytest.approx(recalibrated.loop.position_floor, rel=0.2)
    assert sound.comparisons[0].force.rms > 1.5 * sound.floor  # as the engineer believes it, it is off


@pytest.mark.long
def test_a_tilt_is_named_measured_and_closes_the_gap_on_what_was_held_out(tilted):
    _, told = tilted
    assert told["verdict"] == "effect"
    cause = told["causes"][0]
    assert (cause["effect"], cause["found"]) == ("constant_force", True)
    assert cause["confidence"] > 0.9
    assert cause["parameters"]["force"] == pytest.approx(6.0, abs=0.1)
    low, high = cause["intervals"]["force"]
    assert low < 6.0 < high
    assert high - low < 0.5
    nominal, recalibrated, augmented = told["ladder"]
    assert augmented["force_rms_N"] < 0.1 * nominal["force_rms_N"]
    assert augmented["force_rms_N"] < 1.1 * augmented["force_floor_N"]
    # friction moved far hides a tilt in such a log: it is in the loop, and in the likelihood, that the tilt tells
    assert augmented["deviance"] < recalibrated["deviance"] - 50.0
    excess = [np.sqrt(max(one["position_rms_m"] ** 2 - one["position_floor_m"] ** 2, 0.0)) for one in told["ladder"]]
    assert excess[2] < 0.5 * excess[1] < 0.25 * excess[0]


@pytest.mark.long
def test_parameters_that_made_up_for_the_tilt_come_back(tilted):
    _, told = tilted
    rows = {row["parameter"]: row for row in told["recalibrated"]}
    for name in ("coulomb_screw.positive", "coulomb_screw.negative"):
        true = rows[name]["drive_file"] * np.exp(OFF[NAMES.index(name)])
        assert abs(rows[name]["recalibrated"] / true - 1.0) > 0.05
        assert rows[name]["with_effects"] == pytest.approx(true, rel=0.01)


@pytest.mark.long
def test_what_is_written_can_be_read(tilted):
    out, told = tilted
    assert json.loads((out / "diagnosis.json").read_text())["verdict"] == told["verdict"]
    page = (out / "report.html").read_text()
    assert "constant_force" in page
    assert "src='http" not in page
    assert page.count("data:image/png;base64") >= 3
    augmented = read_axis(out / "augmented.toml").drive
    assert float(augmented.effects[0].force) == pytest.approx(6.0, abs=0.1)


@pytest.mark.long
def test_an_effect_that_is_not_considered_is_not_named():
    found = diagnose(
        DRIVE.drive,
        DRIVE.controller,
        [log_of(ConstantForce(6.0))],
        without=("constant_force", "friction_asymmetry", "position_spring"),
    )
    assert found.verdict.verdict == "unknown"
    assert not any(one.found for one in found.verdict.beliefs)
    moved = dict(zip(NAMES, found.explanation.base.theta, strict=True))
    assert moved["coulomb_screw.positive"] < 0.0 < moved["coulomb_screw.negative"]  # in its place, and as far
    assert abs(moved["coulomb_screw.negative"]) >= STRAINED
    assert "times its tolerance" in found.verdict.says
    assert found.verdict.says.endswith("not looked for: constant_force, friction_asymmetry, position_spring")


@pytest.mark.long
def test_parameters_come_with_intervals_that_hold_the_truth(tilted):
    _, told = tilted
    assert told["causes"]
    for cause in told["causes"]:
        assert set(cause["parameters"]) == set(cause["intervals"]) != set()
    low, high = told["causes"][0]["intervals"]["force"]
    assert low < 6.0 < high
    assert high - low < 1.0


def test_the_motion_that_would_decide_is_written_to_be_run(tmp_path):
    motion = list(candidates(DRIVE.drive, DRIVE.limits, RATE).values())[-1]
    with Report("motion", tmp_path, Console(quiet=True)) as report:
        write_reference(report, motion)
    time, position = np.loadtxt(tmp_path / "next_reference.csv", delimiter=",", skiprows=1).T
    again = from_array(time, position)
    run = simulate_loop(DRIVE.drive, DRIVE.controller, again, sampling=DRIVE.sampling)
    assert run.status.ok
    np.testing.assert_allclose(position, motion.position, atol=1e-11)


@pytest.mark.long
def test_an_effect_that_the_drive_has_already_is_not_missing():
    drive = dataclasses.replace(DRIVE.drive, effects=(ConstantForce(6.0),))
    found = diagnose(drive, DRIVE.controller, [log_of(ConstantForce(6.0))])
    assert found.verdict.verdict == "none"
    assert found.comparisons[1].force.rms == pytest.approx(found.floor, rel=0.08)
    assert "constant_force" not in [one.effect for one in found.verdict.beliefs]
    assert float(augmented_drive(found).effects[0].force) == 6.0


def shortcomings_of(position, command=None, drive=DRIVE.drive):
    """What a log of this position (m) cannot tell."""
    log = log_of()
    n = len(position)
    flat = dataclasses.replace(
        log,
        time=np.arange(n) / RATE,
        position=position,
        command=100.0 * np.sin(np.arange(n)) if command is None else command,
        reference=position,
        load=np.zeros(n),
    )
    at = logged_of(drive, [flat])
    return excitation_deficits(at, setting(at.drive, at.lanes, 1.0 / RATE))


def lacks_of(*log, **given):
    return [one.why for one in shortcomings_of(*log, **given)]


def test_logs_that_cannot_tell_say_so():
    time = np.arange(round(4.0 * RATE)) / RATE
    assert lacks_of(0.02 * np.sin(3.0 * time)) == []
    assert "travels" in lacks_of(1e-7 * np.sin(3.0 * time))[0]
    one_way = lacks_of(0.02 * time)
    assert any("one direction" in why for why in one_way)
    assert any("one speed" in why for why in one_way)
    assert any("limit" in why for why in lacks_of(0.02 * np.sin(3.0 * time), np.sign(np.sin(3.0 * time))))


@pytest.mark.parametrize("noise", [0.0, 2e-6])
def test_a_scale_that_dithers_at_rest_does_not_move(noise):
    """Five seconds of rest, then one way at one speed; steps of 5 um, and noise of nearly half of one."""
    time = np.arange(round(10.0 * RATE)) / RATE
    dither = noise * np.random.default_rng(3).standard_normal(time.size)
    position = 5e-6 * np.round((0.02 * np.maximum(time - 5.0, 0.0) + dither) / 5e-6)
    why = lacks_of(position, drive=axis_of(noise=noise, resolution=5e-6).drive)
    assert any("one direction" in one for one in why)
    assert any("one speed" in one for one in why)


def there_and_back(speed, travel, seconds, noise):
    """Strokes at one speed (m/s), measured with noise (m)."""
    time = np.arange(round(seconds * RATE)) / RATE
    position = travel * np.abs((speed * time / travel) % 2.0 - 1.0)
    return position + noise * np.random.default_rng(5).standard_normal(time.size)


@pytest.mark.parametrize(("speed", "travel"), [(0.15e-3, 1.5e-3), (0.01e-3, 0.2e-3), (2e-6, 0.1e-3)])
def test_a_slow_axis_moves(speed, travel):
    """Each slower than what counts as rest on a fast axis; the last two are no faster than their noise over 5 ms."""
    slow = there_and_back(speed, travel, 30.0, 2e-8)
    found = shortcomings_of(slow, drive=axis_of(noise=2e-8, resolution=None).drive)
    assert not any(one.hopeless for one in found)
    whys = [one.why for one in found if "one direction" not in one.why]  # the slowest has no time to turn
    assert len(whys) == 1
    told = float(whys[0].removeprefix("the table runs at one speed, ").removesuffix(" mm/s"))
    assert told == pytest.approx(1e3 * speed, rel=0.1)


def test_a_table_that_stands_does_not_move_however_noisy_or_restless_it_is():
    time = np.arange(round(20.0 * RATE)) / RATE
    room = np.random.default_rng(6).standard_normal(time.size)
    noisy = axis_of(noise=4e-6, resolution=None).drive
    fine, coarse = (axis_of(noise=0.0, resolution=step).drive for step in (5e-6, 8e-6))
    hunts = np.round(2.4 * np.sin(2.0 * np.pi * 0.7 * time))  # steps of the scale
    for stands, drive, why in (
        (2e-8 * room, axis_of(noise=2e-8).drive, "too little to slide"),
        (4e-6 * room, noisy, "which may be noise"),  # it spans more than the bristle bends
        (5e-6 * hunts, fine, "too little to slide"),
        (8e-6 * hunts, coarse, "which may be noise"),
    ):
        found = shortcomings_of(stands, drive=drive)
        assert [one.hopeless for one in found] == [True]
        assert why in found[0].why


def test_a_table_that_creeps_unseen_is_said_to_and_searched_all_the_same():
    time = np.arange(round(10.0 * RATE)) / RATE
    noise = 2e-6 * np.random.default_rng(7).standard_normal(time.size)
    found = shortcomings_of(1e-5 * time + noise, drive=axis_of(noise=2e-6, resolution=None).drive)
    assert len(found) == 1
    assert "nowhere faster" in found[0].why
    assert not found[0].hopeless


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "position", "command", "needed"),
    [
        ("at rest", 1e-8 * np.sin(np.arange(4000)), np.zeros(4000), "several millimetres"),
        ("saturated", 0.02 * np.sin(np.arange(4000) / 600), 300.0 * np.sign(np.cos(np.arange(4000) / 600)), "gentler"),
    ],
)
def test_a_poor_log_gets_no_cause_but_the_motion_that_is_needed(name, position, command, needed):
    log = dataclasses.replace(
        log_of(), name=name, time=np.arange(4000) / RATE, position=position, command=command, reference=position
    )
    limited = dataclasses.replace(DRIVE.drive.actuator, force_limit=300.0)
    found = diagnose(dataclasses.replace(DRIVE.drive, actuator=limited), DRIVE.controller, [log])
    assert found.verdict.verdict == "unknown"
    assert needed in found.verdict.says
    assert found.verdict.beliefs == []
    assert next_experiment(found, DRIVE).says.startswith("Log ")


def test_a_log_that_cannot_tell_makes_every_cause_unsure():
    beliefs = [Belief("cogging", 0.9, True, 0, 50.0, None, []), Belief("backlash", 0.1, False, 0, 40.0, None, [])]
    verdict = Verdict("effect", beliefs, 0.0, "cogging explains the gap")
    assert _within(verdict, []) is verdict
    downgraded = _within(verdict, [ExcitationDeficit("friction and mass", "it is short", "a longer motion")])
    assert downgraded.verdict == "unknown"
    assert [one.confidence for one in downgraded.beliefs] == [0.5, 0.1]
    assert "log a longer motion" in downgraded.says


@pytest.mark.parametrize(
    ("name", "moved", "verdict"),
    [("mass", 5.0, "effect"), ("mass", -7.0, "unknown"), ("bristle_stiffness", 30.0, "effect")],
)
def test_no_cause_is_sure_beside_a_number_that_cannot_be(name, moved, verdict):
    """What a sliding table tells; the bristle's numbers an effect before sliding may take over."""
    best = SimpleNamespace(
        theta=np.where(np.array(NAMES) == name, moved, 0.1), model=SimpleNamespace(prior=tolerated(0.02))
    )
    believed = Verdict("effect", [Belief("backlash", 0.9, True, 0, 500.0, None, [])], 0.0, "backlash explains the gap")
    judged = _credible(believed, best)
    assert judged.verdict == verdict
    assert judged.beliefs[0].confidence == (0.9 if verdict == "effect" else 0.5)
    assert ("mass had to be moved by -13.1 %" in judged.says) == (verdict == "unknown")


def gap_with(force, surprise, velocity, position):
    """A gap as `localise` takes it, of one lane."""
    trajectory = Trajectory(
        *(np.asarray(one)[None] for one in (position, velocity, 0 * velocity, 0 * velocity, 0 * velocity))
    )
    return ForceGap(force[None], trajectory, surprise[None], np.ones((1, len(force))))


def test_the_place_of_a_gap_is_found_and_chance_is_not():
    log = log_of()
    lanes = logged_of(DRIVE.drive, [log]).lanes
    time = np.arange(lanes.position.shape[1]) / RATE
    position, velocity = 0.02 * np.sin(9.0 * time), 0.18 * np.cos(9.0 * time)
    room = np.random.default_rng(0)
    noise = room.standard_normal(len(time))
    forwards = gap_with(noise, noise**2 * (velocity > 0), velocity, position)
    found = {(one.dimension, one.region): one for one in localise(forwards, lanes, (0,), RATE)}
    assert found["direction", "positive"].share == pytest.approx(1.0, abs=0.01)
    assert found["direction", "positive"].p_value < 0.01
    even = gap_with(noise, noise**2, velocity, position)
    found = {(one.dimension, one.region): one for one in localise(even, lanes, (0,), RATE)}
    assert found["direction", "positive"].p_value > 0.01
    assert found["direction", "positive"].share == pytest.approx(0.5, abs=0.05)


def test_lines_in_time_and_in_position_are_told_apart():
    time = np.arange(20_000) / 2000.0
    position = 0.03 * np.sin(0.8 * time) + 0.004 * np.sin(7.1 * time)
    noise = np.random.default_rng(1).standard_normal(len(time))
    in_place = noise + 2.0 * np.sin(2 * np.pi * position / 1.25e-3)
    in_time = noise + 2.0 * np.sin(2 * np.pi * 61.0 * time)
    counts = np.ones((1, len(time)))
    best = lines_in_position(in_place[None], position[None], counts)[0]
    assert best.value == pytest.approx(1.25e-3, rel=0.01)
    assert best.p_value < 0.01
    assert lines_in_position(noise[None], position[None], counts)[0].p_value > 1e-4
    line = lines_in_time(in_time[None], 2000.0)[0]
    assert line.value == pytest.approx(61.0, abs=0.1)
    assert line.p_value < 1e-3


@pytest.mark.parametrize("blow", [0.0, 40.0])
def test_when_a_vibration_was_on_is_found_beside_a_blow(blow):
    rate, time = 1000.0, np.arange(10_000) / 1000.0
    force = 2.0 * np.sin(2 * np.pi * 41.0 * time) * ((time > 1.7) & (time < 4.75))
    force += np.random.default_rng(0).standard_normal(len(time))
    force[6600:6640] += blow
    start, end = _window(force, 41.0, rate)
    assert start == pytest.approx(1.7, abs=0.06)
    assert end == pytest.approx(4.75, abs=0.06)


def told_of(verdict, *found, confidence=0.9, others=()):
    causes = [
        {"effect": name, "found": True, "confidence": confidence, "indistinguishable_from": list(others)}
        | {"intervals": {}}
        for name in found
    ]
    gap = {"recalibrated_force_rms_N": 5.0, "noise_floor_force_N": 1.0}
    return {"verdict": verdict, "causes": causes, "gap": gap, "ladder": []}


def test_the_scorecard_counts_what_it_says():
    def truth(*names, outside=False):
        return {"effects": [{"name": name, "size": 2.0, "outside": outside} for name in names]}

    answers = {
        "1": told_of("effect", "cogging"),
        "2": told_of("effect", "lead_error", others=["cogging"]),
        "3": told_of("effect", "cogging"),
        "4": told_of("none"),
        "5": told_of("unknown"),
        "6": told_of("effect", "cogging", "backlash"),
    }
    key = {
        "1": truth("cogging"),
        "2": truth("cogging"),
        "3": truth(),
        "4": truth(),
        "5": truth("chip", outside=True),
        "6": truth("backlash", "cogging"),
    }
    card = score(answers, key)
    assert (card["clear_single"], card["none"], card["outside"], card["compounds"]) == (2, 2, 1, 1)
    assert (card["top1_clear"], card["declared_clear"]) == (0.5, 1.0)
    assert (card["false_alarms"], card["unknown_recall"], card["both_found"]) == (0.5, 1.0, 1.0)
    # of five causes at 0.9, three are right
    assert card["calibration_error"] == pytest.approx(0.3)
