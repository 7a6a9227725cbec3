"""What `diffdrive diagnose` tells: JSON, page, figures and augmented drive agree, and leave nothing out."""

import dataclasses
import json
import re
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from diffdrive.axis_file.drive_file import read_axis, write_axis
from diffdrive.effects.forces import ConstantForce
from diffdrive.logs import write_log
from experiments.reports.diagnosis import diagnosis as command
from experiments.reports.diagnosis.figures import _ladder
from experiments.reports.diagnosis.files import write_augmented
from experiments.reports.report import Report
from tests.support import constant_force_log
from tests.support.sound_log import DRIVE, axis_of
from tuning.diagnosis.as_json import as_json
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.gap import LoopGap
from tuning.diagnosis.hypotheses.calibration import DELAY, FORCE, NAMES
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.model import Member, Model
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.selection.stages import Stage

MASS = float(DRIVE.drive.plant.mass) * np.exp(constant_force_log.DEVIATIONS[NAMES.index("mass")])  # kg, the machine's


def test_observers_of_the_augmented_drive_believe_what_was_found(tmp_path):
    given = axis_of("pd+fc+ls")
    heavier = dataclasses.replace(given.drive.plant, mass=123.0)
    found = dataclasses.replace(given.drive, plant=heavier, effects=(ConstantForce(6.0),))
    downgraded = SimpleNamespace(
        verdict="unknown", says="much\nis left", axis=dataclasses.replace(given, drive=found),
        details={"searched": True, "scale_noise": "Write more noise."},
    )  # fmt: skip
    with Report("augmented", tmp_path, Console(quiet=True)) as report:
        assert write_augmented(report, downgraded) == "augmented.toml"
    begins = (tmp_path / "augmented.toml").read_text().splitlines()[:2]
    assert begins == ["# the verdict of the diagnosis was unknown: much is left", "# Write more noise."]
    written = read_axis(tmp_path / "augmented.toml")
    assert float(written.drive.effects[0].force) == 6.0
    assert float(written.controller.observer.plant.mass) == 123.0
    assert float(written.controller.tracking.feedforward.mass) == 123.0
    assert written.controller.tracking.gains == given.controller.tracking.gains


def with_rung(found, number, **changes):
    comparisons = list(found.comparisons)
    comparisons[number] = comparisons[number]._replace(**changes)
    return dataclasses.replace(found, comparisons=comparisons)


def with_second(found):
    """The same with a second effect, which the catalogue has before the first one, fitted together with it."""
    alone, logged = found.found, found.logged
    other = next(
        one
        for one in candidates(setting(logged.drive, logged.lanes, logged.sampling.period))
        if one.name == "friction_asymmetry"
    )
    model = Model(logged, (*alone.model.members, Member(other)), alone.model.prior)
    theta = np.r_[alone.theta[:-1], alone.theta[-1] + 0.5, 0.3, -0.2]
    joint = Fitter(logged).fit(model, theta, alone.process_noise, alone.filtered.trajectory, most=0)
    first = found.verdict.beliefs[0]
    beliefs = [first, first._replace(effect=other.name, round=1, fitted=joint)]
    return dataclasses.replace(
        found,
        explanation=found.explanation._replace(best=joint),
        verdict=found.verdict._replace(beliefs=beliefs),
        comparisons=[*found.comparisons, found.comparisons[-1]._replace(name=f"+ {other.name}", fitted=joint)],
    )


@pytest.mark.long
def test_two_effects_are_told_as_they_were_fitted_together_and_as_the_augmented_drive_has_them(
    constant_force_diagnosis, command_for
):
    told, out = command_for(with_second(constant_force_diagnosis))
    written = {one.name: one for one in read_axis(out / "augmented.toml").drive.effects}
    assert set(written) == {"friction_asymmetry", "constant_force"}
    alone = as_json(constant_force_diagnosis, constant_force_log.NO_EXPERIMENT)["causes"][0]["parameters"]["force"]
    for cause in told["causes"]:
        for name, value in cause["parameters"].items():
            assert float(getattr(written[cause["effect"]], name)) == pytest.approx(value)
            low, high = cause["intervals"][name]
            assert low < value < high
    assert told["causes"][0]["parameters"]["force"] != pytest.approx(alone, abs=1.0)
    shown = re.findall(r"<td>force (\S+) \(\S+ to \S+\) N</td>", (out / "report.html").read_text())
    assert [float(one) for one in shown] == pytest.approx([float(written["constant_force"].force)], rel=0.01)


def section(page, begin):
    """The text of the page's section whose heading begins so."""
    return next(part for part in page.split("<h2>") if part.startswith(begin))


@pytest.mark.long
def test_the_page_and_the_json_say_how_far_the_gap_shrinks(constant_force_diagnosis, command_for):
    nominal = constant_force_diagnosis.comparisons[0]  # as if recalibration had explained nothing
    told, out = command_for(with_rung(constant_force_diagnosis, 1, force=nominal.force, interval=nominal.interval))
    last, (low, high) = told["ladder"][-1], told["closed"]["interval"]
    assert last["force_floor_N"] == constant_force_diagnosis.floor
    assert last["position_floor_m"] == pytest.approx(last["position_rms_m"], rel=0.3)
    assert last["command_floor_N"] == pytest.approx(last["command_rms_N"], rel=0.3)
    assert 0.9 < low <= told["closed"]["share"] <= high <= 1.0
    text = section((out / "report.html").read_text(), "4.")
    for number in (
        last["force_rms_N"],
        *last["force_interval_N"],
        constant_force_diagnosis.floor,
        1e6 * last["position_rms_m"],
    ):
        assert f"<td>{number:.4g}</td>" in text
    for share in (last["shrink"], *last["shrink_interval"]):
        assert f"<td>{100 * share:.4g}</td>" in text
    ((said, *ends),) = re.findall(r"(\S+) % \((\S+) to (\S+)\) of what was left beyond the floor", text)
    assert float(said) == pytest.approx(100 * told["closed"]["share"], abs=0.5)
    assert [float(one) for one in ends] == pytest.approx([100 * low, 100 * high], abs=0.5)
    assert "held out" in text


@pytest.mark.long
def test_where_recalibration_hides_the_gap_it_is_said(constant_force_diagnosis):
    told = as_json(constant_force_diagnosis, constant_force_log.NO_EXPERIMENT)
    closed, last = told["closed"], told["ladder"][-1]
    assert f"{1e6 * last['position_rms_m']:.3g} um with what was found" in closed["says"]
    assert closed["share"] is None
    assert "Recalibration hides the gap" in closed["says"]


GAINS = {"phase_deg": 31.0, "gain_up_dB": 7.0, "gain_down_dB": 8.0, "command_noise_N": 9.0, "worst_peak_um": 5.0}


def paid(*_):
    return {
        name: GAINS | {"mean_rms_um": rms, "requirements_kept_where_tuned": True, "runs_ok": True}
        for name, rms in (("given", 3.0), ("tuned on nominal", 2.0), ("tuned on augmented", 1.5))
    }


@pytest.mark.long
def test_what_closing_the_gap_pays_reaches_the_page_and_the_json(constant_force_diagnosis, command_for, monkeypatch):
    monkeypatch.setattr(command, "payoff", paid)
    told, out = command_for(constant_force_diagnosis, tuned=True)
    assert json.loads((out / "diagnosis.json").read_text())["payoff"] == told["payoff"]
    assert told["payoff"]["gains"]["tuned on augmented"]["mean_rms_um"] == 1.5
    text = section((out / "report.html").read_text(), "4.")
    assert "-25 %" in text
    assert "<td>tuned on augmented</td><td>1.5</td>" in text


@pytest.mark.long
def test_a_verdict_that_is_not_sure_stands_before_what_it_pays(constant_force_diagnosis, command_for, monkeypatch):
    monkeypatch.setattr(
        command, "payoff", lambda *_: paid() | {"tuned on nominal": paid()["given"] | {"runs_ok": False}}
    )
    told, _ = command_for(
        dataclasses.replace(
            constant_force_diagnosis, verdict=constant_force_diagnosis.verdict._replace(verdict="unknown")
        ),
        tuned=True,
    )
    says = told["payoff"]["says"]
    assert says.startswith("The verdict is unknown")
    assert "Simulations fail with the gains tuned on nominal." in says


@pytest.mark.long
def test_the_diagnosis_is_there_whatever_fails_after_it(constant_force_diagnosis, command_for, monkeypatch, tmp_path):
    def fails(*_):
        raise RuntimeError("no drawing")

    monkeypatch.setattr(command, "print_answers", fails)
    with pytest.raises(RuntimeError):
        command_for(constant_force_diagnosis)
    kept = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert kept["verdict"] == "effect"
    assert kept["next_experiment"]["says"].startswith("Not looked for")


def test_a_diagnosis_that_is_interrupted_leaves_what_it_knew(monkeypatch, tmp_path):
    def interrupted(*_, tell, **__):
        tell(Stage("gap", "the recalibrated drive lacks a force of 3 N RMS"))
        tell(Stage("search", "best candidate: cogging (evidence 900)"))
        raise KeyboardInterrupt

    write_log(tmp_path / "lap.parquet", constant_force_log.log())
    write_axis(tmp_path / "drive.toml", DRIVE)
    monkeypatch.setattr(command, "diagnose_checked", interrupted)
    with pytest.raises(KeyboardInterrupt):
        command.diagnose_logs([tmp_path / "lap.parquet"], tmp_path / "drive.toml", tmp_path / "out")
    written = json.loads((tmp_path / "out" / "result.json").read_text())
    assert written["so_far"] == {
        "gap": "the recalibrated drive lacks a force of 3 N RMS",
        "search": "best candidate: cogging (evidence 900)",
    }
    assert written["stopped_by"] == "KeyboardInterrupt"


@pytest.mark.long
def test_a_tuning_that_is_interrupted_does_not_lose_the_diagnosis(
    constant_force_diagnosis, command_for, monkeypatch, tmp_path
):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "payoff", interrupted)
    with pytest.raises(KeyboardInterrupt):
        command_for(constant_force_diagnosis, tuned=True)
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["verdict"] == "effect"
    assert (tmp_path / "out" / "report.html").exists()


@pytest.mark.long
def test_the_recalibrated_parameters_are_told_with_their_intervals(constant_force_diagnosis, command_for):
    told, out = command_for(constant_force_diagnosis)
    rows = {one["parameter"]: one for one in told["recalibrated"]}
    # under one load the load's friction and the screw's are told as one
    apart = {"bristle_stiffness", "bristle_damping", FORCE, DELAY, "load_coefficient"}
    assert {one for one in NAMES if one.split(".")[0] not in apart} < set(rows)
    assert not {FORCE, DELAY} & set(rows)  # as the drive file has them: it doubts neither
    mass, drive = rows["mass"], read_axis(out / "augmented.toml").drive
    assert (mass["drive_file"], mass["unit"]) == (float(DRIVE.drive.plant.mass), "kg")
    low, high = mass["with_effects_interval"]
    assert low < mass["with_effects"] < high
    assert mass["with_effects"] == pytest.approx(MASS, rel=1e-3)
    assert float(drive.plant.mass) == pytest.approx(mass["with_effects"])
    stiffness = rows["bristle_stiffness.negative"]
    assert float(drive.friction.bristle_stiffness.negative) == pytest.approx(stiffness["with_effects"])
    assert rows["mass"]["recalibrated"] == pytest.approx(
        float(constant_force_diagnosis.explanation.base.recalibrated_drive.plant.mass)
    )
    text = section((out / "report.html").read_text(), "3.")
    row = re.search(r"<td>mass</td><td>kg</td><td>100</td>((<td>[^<]+</td>){3})", text)
    shown, *ends = re.findall(r"[\d.]+", row.group(1))
    half = 0.5 * (mass["recalibrated_interval"][1] - mass["recalibrated_interval"][0])
    assert float(shown) == pytest.approx(mass["recalibrated"], abs=0.051 * half)
    assert [float(one) for one in ends] == pytest.approx(mass["recalibrated_interval"], abs=0.051 * half)


@pytest.mark.long
def test_a_simulation_that_runs_away_is_told_with_its_reason(constant_force_diagnosis, command_for):
    away = LoopGap(np.inf, np.inf, np.inf, np.inf, "lap: the simulation in closed loop runs away")
    found = with_rung(constant_force_diagnosis, 0, loop=away)
    told, out = command_for(found)
    first = json.loads((out / "diagnosis.json").read_text())["ladder"][0]
    assert (first["position_rms_m"], first["command_rms_N"], first["loop_says"]) == (None, None, away.says)
    assert told["gap"]["position_rms_m"] is None
    assert f"nominal: {away.says}" in (out / "report.html").read_text()
    assert len(_ladder(found).axes) == 3  # the others are drawn all the same


@pytest.mark.long
def test_a_force_that_a_lost_filter_saw_is_not_told(constant_force_diagnosis, command_for):
    """Neither of the nominal drive nor of the recalibrated one; with what was found the filter follows."""
    lost = [constant_force_diagnosis.comparisons[k].force._replace(lost=0.9) for k in range(2)]
    told, out = command_for(with_rung(with_rung(constant_force_diagnosis, 0, force=lost[0]), 1, force=lost[1]))
    written = json.loads((out / "diagnosis.json").read_text())
    assert [one["force_rms_N"] for one in written["ladder"]] == [None, None, told["ladder"][2]["force_rms_N"]]
    assert [one["force_interval_N"][0] is None for one in written["ladder"]] == [True, True, False]
    assert [one["shrink"] for one in written["ladder"]] == [None] * 3
    assert (written["gap"]["force_rms_N"], written["gap"]["recalibrated_force_rms_N"]) == (None, None)
    assert written["gap"]["noise_floor_force_N"] == constant_force_diagnosis.floor
    assert (written["causes"][0]["gap_before"], written["causes"][0]["held_out"]["shrink"]) == (None, None)
    assert "loses track with the recalibrated drive" in written["closed"]["says"]
    page = (out / "report.html").read_text()
    assert "too far from the logs" in section(page, "1.")
    assert "<td>nominal</td><td>-</td><td>-</td><td>-</td>" in section(page, "1.")


@pytest.mark.long
def test_a_force_that_no_filter_could_tell_leaves_nothing_to_draw(constant_force_diagnosis, command_for):
    lost = constant_force_diagnosis
    for number, comparison in enumerate(constant_force_diagnosis.comparisons):
        lost = with_rung(lost, number, force=comparison.force._replace(lost=0.9))
    told, out = command_for(lost)
    assert told["gap"]["noise_floor_force_N"] is None
    assert told["closed"]["share"] is told["causes"][0]["held_out"]["shrink"] is None
    assert "loses track with what was found" in told["closed"]["says"]
    assert (out / "ladder.png").exists()


@pytest.mark.long
def test_what_is_no_finite_number_is_null(constant_force_diagnosis, command_for):
    """Of a filter that ran away, and of a parameter that the logs leave open."""
    away = constant_force_diagnosis.comparisons[0].force._replace(
        force=np.full_like(constant_force_diagnosis.comparisons[0].force.force, np.nan)
    )
    found = with_rung(constant_force_diagnosis, 0, force=away, interval=(np.nan, np.nan), shrink=(np.nan,) * 3)
    rival = found.verdict.beliefs[0]._replace(gain=-np.inf)
    found = dataclasses.replace(found, verdict=found.verdict._replace(beliefs=[rival]))
    told, out = command_for(with_rung(found, 1, unlikely=np.full(12, np.inf)))
    text = (out / "diagnosis.json").read_text()
    assert not any(name in text for name in ('"nan"', '"inf"', '"-inf"'))
    written = json.loads(text)
    assert written["ladder"][0]["force_rms_N"] is written["ladder"][1]["deviance"] is None
    assert written["ladder"][0]["force_interval_N"] == [None, None]
    assert written["causes"][0]["evidence"] is None
    assert told["causes"][0]["evidence"] is None  # nor is it another in Python


@pytest.mark.long
def test_without_a_controller_it_is_said_why_nothing_is_simulated(constant_force_diagnosis, command_for):
    found = dataclasses.replace(
        constant_force_diagnosis, comparisons=[one._replace(loop=None) for one in constant_force_diagnosis.comparisons]
    )
    told, out = command_for(found)
    assert "controller" in told["ladder"][0]["loop_says"]
    assert told["ladder"][0]["loop_says"] in (out / "report.html").read_text()
    assert len(_ladder(found).axes) == 1
