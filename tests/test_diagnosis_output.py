"""What `diffdrive diagnose` tells: JSON, page, figures and augmented drive agree, and leave nothing out."""

import dataclasses
import io
import json
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console
from sound_log import DRIVE, SOUND, described, logged, moved, two_sines

from diffdrive.drive_file import read_drive, write_drive
from diffdrive.effects.forces import ConstantForce
from diffdrive.logs import write_log
from diffdrive.logs.plausibility import Finding
from experiments import diagnose as command
from experiments.cause_words import headline, numbers, parameter
from experiments.diagnose_figures import _ladder
from experiments.diagnosis_json import as_json
from experiments.report import Report
from experiments.withheld import answer
from tuning.diagnosis.calibration import NAMES, calibrated
from tuning.diagnosis.candidates import candidates
from tuning.diagnosis.diagnose import diagnose
from tuning.diagnosis.fitting import Fitter
from tuning.diagnosis.gap import LoopGap
from tuning.diagnosis.model import Member, Model
from tuning.diagnosis.next_experiment import Experiment
from tuning.diagnosis.setting import setting
from tuning.diagnosis.threads import in_parallel

OFF = np.random.default_rng(8).uniform(-0.02, 0.02, len(NAMES))  # how far the machine is from its file
UNASKED = Experiment("", [], 0.0, "not asked")
MASS = float(DRIVE.drive.plant.mass) * np.exp(OFF[NAMES.index("mass")])  # kg, the machine's


@pytest.fixture(scope="module")
def log():
    machine = jax.tree.map(float, calibrated(DRIVE.drive, jnp.asarray(OFF)))
    return logged(
        dataclasses.replace(DRIVE, drive=dataclasses.replace(machine, effects=(ConstantForce(6.0),))), two_sines()
    )


@pytest.fixture(scope="module")
def tilted(log):
    return diagnose(DRIVE.drive, DRIVE.controller, [log])


def test_observers_of_the_augmented_drive_believe_what_was_found(monkeypatch, tmp_path):
    given = described("pd+fc+ls")
    heavier = dataclasses.replace(given.drive.plant, mass=123.0)
    found = dataclasses.replace(given.drive, plant=heavier, effects=(ConstantForce(6.0),))
    monkeypatch.setattr(command, "augmented_drive", lambda _: found)
    with Report("augmented", tmp_path, Console(quiet=True)) as report:
        doubted = SimpleNamespace(verdict=SimpleNamespace(verdict="unknown", says="much\nis left"))
        assert command._write(report, given, doubted) == "augmented.toml"
    assert (
        (tmp_path / "augmented.toml")
        .read_text()
        .startswith("# the verdict of the diagnosis was unknown: much is left\n")
    )
    written = read_drive(tmp_path / "augmented.toml")
    assert float(written.drive.effects[0].force) == 6.0
    assert float(written.controller.observer.plant.mass) == 123.0
    assert float(written.controller.tracking.feedforward.mass) == 123.0
    assert written.controller.tracking.gains == given.controller.tracking.gains


@pytest.fixture
def told_of(log, tmp_path, monkeypatch):
    """The command on this log, as if it had found what it is given; and the folder that it wrote."""

    def run(found, log=log, **options):
        write_log(tmp_path / "lap.parquet", log)
        write_drive(tmp_path / "drive.toml", DRIVE)
        monkeypatch.setattr(command, "diagnose", lambda *_, **__: found)
        monkeypatch.setattr(command, "next_experiment", lambda *_: UNASKED)
        out = tmp_path / "out"
        return command.diagnose_logs([tmp_path / "lap.parquet"], tmp_path / "drive.toml", out, **options), out

    return run


def with_rung(found, number, **changes):
    rungs = list(found.rungs)
    rungs[number] = rungs[number]._replace(**changes)
    return dataclasses.replace(found, rungs=rungs)


def with_second(found):
    """The same with a second effect, which the catalogue has before the first one, fitted together with it."""
    alone, logged = found.found, found.logged
    other = next(
        one
        for one in candidates(setting(logged.drive, logged.lanes, logged.sampling.period))
        if one.name == "friction_asymmetry"
    )
    model = Model(logged, (*alone.model.members, Member(other)), alone.model.tolerance)
    u = np.r_[alone.u[:-1], alone.u[-1] + 0.5, 0.3, -0.2]
    joint = Fitter(logged).fit(model, u, alone.process, alone.track.course, most=0)
    first = found.verdict.beliefs[0]
    beliefs = [first, first._replace(effect=other.name, round=1, fitted=joint)]
    return dataclasses.replace(
        found,
        explanation=found.explanation._replace(best=joint),
        verdict=found.verdict._replace(beliefs=beliefs),
        rungs=[*found.rungs, found.rungs[-1]._replace(name=f"+ {other.name}", fitted=joint)],
    )


def test_two_effects_are_told_as_they_were_fitted_together_and_as_the_augmented_drive_has_them(tilted, told_of):
    told, out = told_of(with_second(tilted))
    written = {one.name: one for one in read_drive(out / "augmented.toml").drive.effects}
    assert set(written) == {"friction_asymmetry", "constant_force"}
    alone = as_json(tilted, UNASKED)["causes"][0]["parameters"]["force"]
    for cause in told["causes"]:
        for name, value in cause["parameters"].items():
            assert float(getattr(written[cause["effect"]], name)) == pytest.approx(value)
            low, high = cause["intervals"][name]
            assert low < value < high
    assert told["causes"][0]["parameters"]["force"] != pytest.approx(alone, abs=1.0)
    assert f"force {float(written['constant_force'].force):.4g} (" in (out / "report.html").read_text()


def section(page, begin):
    """The text of the page's section whose heading begins so."""
    return next(part for part in page.split("<h2>") if part.startswith(begin))


def test_the_page_and_the_json_say_how_far_the_gap_shrinks(tilted, told_of):
    nominal = tilted.rungs[0]  # as if recalibration had explained nothing
    told, out = told_of(with_rung(tilted, 1, force=nominal.force, interval=nominal.interval))
    last, (low, high) = told["ladder"][-1], told["closed"]["interval"]
    assert last["force_floor_N"] == tilted.floor
    assert last["position_floor_m"] == pytest.approx(last["position_rms_m"], rel=0.3)
    assert last["command_floor_N"] == pytest.approx(last["command_rms_N"], rel=0.3)
    assert 0.9 < low <= told["closed"]["share"] <= high <= 1.0
    text = section((out / "report.html").read_text(), "4.")
    for number in (last["force_rms_N"], *last["force_interval_N"], tilted.floor, 1e6 * last["position_rms_m"]):
        assert f"<td>{number:.4g}</td>" in text
    for share in (last["shrink"], *last["shrink_interval"]):
        assert f"<td>{100 * share:.4g}</td>" in text
    assert f"{100 * told['closed']['share']:.0f} % (" in text
    assert "held out" in text


def test_where_recalibration_hides_the_gap_it_is_said(tilted):
    told = as_json(tilted, UNASKED)
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


def test_what_closing_the_gap_pays_reaches_the_page_and_the_json(tilted, told_of, monkeypatch):
    monkeypatch.setattr(command, "payoff", paid)
    told, out = told_of(tilted, tuned=True)
    assert json.loads((out / "diagnosis.json").read_text())["payoff"] == told["payoff"]
    assert told["payoff"]["gains"]["tuned on augmented"]["mean_rms_um"] == 1.5
    text = section((out / "report.html").read_text(), "4.")
    assert "-25 %" in text
    assert "<td>tuned on augmented</td><td>1.5</td>" in text


def test_a_verdict_that_is_not_sure_stands_before_what_it_pays(tilted, told_of, monkeypatch):
    monkeypatch.setattr(
        command, "payoff", lambda *_: paid() | {"tuned on nominal": paid()["given"] | {"runs_ok": False}}
    )
    told, _ = told_of(dataclasses.replace(tilted, verdict=tilted.verdict._replace(verdict="unknown")), tuned=True)
    says = told["payoff"]["says"]
    assert says.startswith("The verdict is unknown")
    assert "Simulations fail with the gains tuned on nominal." in says


def test_a_fatal_finding_is_mended_before_any_motion(tilted, told_of, monkeypatch):
    fatal = [("lap", Finding("fatal", "position", "steps", "give the unit"))]
    monkeypatch.setattr(command, "read", lambda *_: ((), [], fatal))
    monkeypatch.setattr(command, "draw", lambda *_: None)
    told, _ = told_of(tilted)
    assert told["next_experiment"]["says"] == "before any motion, mend lap: give the unit"


def test_the_diagnosis_is_there_whatever_fails_after_it(tilted, told_of, monkeypatch, tmp_path):
    def fails(*_):
        raise RuntimeError("no drawing")

    monkeypatch.setattr(command, "tell", fails)
    with pytest.raises(RuntimeError):
        told_of(tilted)
    kept = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert kept["verdict"] == "effect"
    assert kept["next_experiment"]["says"].startswith("not looked for")


def test_a_tuning_that_is_interrupted_does_not_lose_the_diagnosis(tilted, told_of, monkeypatch, tmp_path):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "payoff", interrupted)
    with pytest.raises(KeyboardInterrupt):
        told_of(tilted, tuned=True)
    assert json.loads((tmp_path / "out" / "diagnosis.json").read_text())["verdict"] == "effect"
    assert (tmp_path / "out" / "report.html").exists()


def test_a_job_without_a_terminal_sees_each_stage_begin_and_end_each_time():
    written = io.StringIO()
    with Report("job", None, Console(file=written, width=120)) as report, report.stages() as progress:
        for stage, most in (("screening", 3), ("fitting", 2), ("screening", 3), ("screening", 3)):
            in_parallel(
                lambda item: item, range(most), lambda done, stage=stage, most=most: progress(stage, done, most)
            )
    lines = [line.partition(",")[0] for line in written.getvalue().splitlines()[1:]]
    screening, fitting = ["screening: 0 of 3", "screening: 3 of 3"], ["fitting: 0 of 2", "fitting: 2 of 2"]
    assert lines == screening + fitting + screening + screening


def test_a_parameter_that_differs_from_log_to_log_is_told_for_each():
    cause = {
        "parameters": {"sine": [1.0, -2.0], "period": 0.005, "rested": [0.3]},
        "intervals": {"sine": ([0.9, -2.1], [1.1, -1.9]), "period": (0.004, 0.006), "rested": ([0.2], [0.4])},
        "units": {"sine": "N", "period": "m", "rested": "s"},
        "effect": "cogging",
    }
    assert parameter("sine", cause) == "sine log 1 1 (0.9 to 1.1), log 2 -2 (-2.1 to -1.9) N"
    assert parameter("period", cause) == "period 0.005 (0.004 to 0.006) m"
    assert parameter("rested", cause) == "rested 0.3 (0.2 to 0.4) s"
    cause["intervals"]["period"] = (None, 0.006)
    assert parameter("period", cause) == "period 0.005 (- to 0.006) m"


def test_a_wave_is_told_by_its_amplitude_and_phase_and_what_is_none_not_at_all():
    """3 cos x - 4 sin x = 5 cos(x + 53.13 deg); a second harmonic that its intervals do not tell from none."""
    cause = {
        "effect": "cogging",
        "parameters": {"cosine": [3.0, 5.0], "sine": [-4.0, 0.0], "cosine2": 0.01, "sine2": -0.02, "period": 0.005},
        "intervals": {
            "cosine": ([2.7, 4.7], [3.3, 5.3]), "sine": ([-4.3, -0.3], [-3.7, 0.3]),
            "cosine2": (-0.1, 0.12), "sine2": (-0.13, 0.09), "period": (0.0049, 0.0051),
        },
        "units": dict.fromkeys(("cosine", "sine", "cosine2", "sine2"), "N") | {"period": "m"},
    }  # fmt: skip
    first = "amplitude log 1 5 (4.7 to 5.3), log 2 5 (4.7 to 5.3) N, phase -53, 0 deg"
    assert numbers(cause) == [first, "period 0.005 (0.0049 to 0.0051) m"]
    found = cause | {"confidence": 0.97, "found": True}
    assert (
        headline([found, found | {"found": False}]) == f"cogging, 97 % sure: {first}; period 0.005 (0.0049 to 0.0051) m"
    )


def test_a_headline_shows_the_numbers_that_are_furthest_from_none():
    """A share has no unit; of waves none of which is told from none the largest is shown all the same."""
    cause = {
        "effect": "position_friction", "confidence": 0.97, "found": True,
        "parameters": {"slope": 0.01, "period": 0.1, "cosine": 0.03, "sine": 0.04},
        "intervals": {"slope": (-0.1, 0.12), "period": (0.099, 0.101), "cosine": (0.029, 0.031),
                      "sine": (0.039, 0.041)},
        "units": {"slope": "1/m", "period": "m", "cosine": "1", "sine": "1"},
    }  # fmt: skip
    shown = "amplitude 0.05 (0.049 to 0.051), phase 53 deg; period 0.1 (0.099 to 0.101) m"
    assert headline([cause]) == f"position_friction, 97 % sure: {shown}"
    cause["intervals"] |= {"cosine": (-0.1, 0.2), "sine": (-0.2, 0.2)}
    assert headline([cause]).startswith("position_friction, 97 % sure: amplitude 0.05 (0 to ")
    cause["intervals"] |= {"cosine": (None, None)}
    assert numbers(cause)[0] == "amplitude 0.05 (- to -), phase 53 deg"


def test_what_a_friction_shape_holds_as_logarithms_is_told_as_factors():
    cause = {
        "effect": "friction_shape",
        "parameters": {"stribeck_exponent": np.log(2.0), "coulomb": 0.5},
        "intervals": {"stribeck_exponent": (np.log(1.9), np.log(2.1)), "coulomb": (0.4, 0.6)},
        "units": {"stribeck_exponent": "1", "coulomb": "N"},
    }
    assert numbers(cause) == ["stribeck_exponent 2 (1.9 to 2.1) times the recalibrated", "coulomb 0.5 (0.4 to 0.6) N"]


def test_the_recalibrated_parameters_are_told_with_their_intervals(tilted, told_of):
    told, out = told_of(tilted)
    rows = {one["parameter"]: one for one in told["recalibrated"]}
    assert set(NAMES) - {"bristle_stiffness", "bristle_damping"} < set(rows)
    mass, drive = rows["mass"], read_drive(out / "augmented.toml").drive
    assert (mass["drive_file"], mass["unit"]) == (float(DRIVE.drive.plant.mass), "kg")
    low, high = mass["with_effects_interval"]
    assert low < mass["with_effects"] < high
    assert mass["with_effects"] == pytest.approx(MASS, rel=1e-3)
    assert float(drive.plant.mass) == pytest.approx(mass["with_effects"])
    stiffness = rows["bristle_stiffness.negative"]
    assert float(drive.friction.bristle_stiffness.negative) == pytest.approx(stiffness["with_effects"])
    assert rows["mass"]["recalibrated"] == pytest.approx(float(tilted.explanation.base.own.plant.mass))
    text = section((out / "report.html").read_text(), "3.")
    assert f"<td>mass</td><td>kg</td><td>100</td><td>{mass['recalibrated']:.4g}</td>" in text


def test_a_simulation_that_runs_away_is_told_with_its_reason(tilted, told_of):
    away = LoopGap(np.inf, np.inf, np.inf, np.inf, "lap: the simulation in closed loop runs away")
    found = with_rung(tilted, 0, loop=away)
    told, out = told_of(found)
    first = json.loads((out / "diagnosis.json").read_text())["ladder"][0]
    assert (first["position_rms_m"], first["command_rms_N"], first["loop_says"]) == (None, None, away.says)
    assert told["gap"]["position_rms_m"] is None
    assert f"nominal: {away.says}" in (out / "report.html").read_text()
    assert len(_ladder(found).axes) == 3  # the others are drawn all the same


def test_a_force_that_a_lost_filter_saw_is_not_told(tilted, told_of):
    """Neither of the nominal drive nor of the recalibrated one; with what was found the filter follows."""
    lost = [tilted.rungs[k].force._replace(lost=0.9) for k in range(2)]
    told, out = told_of(with_rung(with_rung(tilted, 0, force=lost[0]), 1, force=lost[1]))
    written = json.loads((out / "diagnosis.json").read_text())
    assert [one["force_rms_N"] for one in written["ladder"]] == [None, None, told["ladder"][2]["force_rms_N"]]
    assert [one["force_interval_N"][0] is None for one in written["ladder"]] == [True, True, False]
    assert [one["shrink"] for one in written["ladder"]] == [None] * 3
    assert (written["gap"]["force_rms_N"], written["gap"]["recalibrated_force_rms_N"]) == (None, None)
    assert written["gap"]["noise_floor_force_N"] == tilted.floor
    assert (written["causes"][0]["gap_before"], written["causes"][0]["held_out"]["shrink"]) == (None, None)
    assert "lost with the recalibrated drive" in written["closed"]["says"]
    page = (out / "report.html").read_text()
    assert "too far from the logs" in section(page, "1.")
    assert "<td>nominal</td><td>-</td><td>-</td><td>-</td>" in section(page, "1.")


def test_a_force_that_no_filter_could_tell_leaves_nothing_to_draw(tilted, told_of):
    lost = tilted
    for number, rung in enumerate(tilted.rungs):
        lost = with_rung(lost, number, force=rung.force._replace(lost=0.9))
    told, out = told_of(lost)
    assert told["gap"]["noise_floor_force_N"] is None
    assert told["closed"]["share"] is told["causes"][0]["held_out"]["shrink"] is None
    assert "lost with what was found" in told["closed"]["says"]
    assert (out / "ladder.png").exists()


def test_what_is_no_finite_number_is_null(tilted, told_of):
    """Of a filter that ran away, and of a parameter that the logs leave open."""
    away = tilted.rungs[0].force._replace(force=np.full_like(tilted.rungs[0].force.force, np.nan))
    found = with_rung(tilted, 0, force=away, interval=(np.nan, np.nan), shrink=(np.nan,) * 3)
    rival = found.verdict.beliefs[0]._replace(gain=-np.inf)
    found = dataclasses.replace(found, verdict=found.verdict._replace(beliefs=[rival]))
    told, out = told_of(with_rung(found, 1, unlikely=np.full(12, np.inf)))
    text = (out / "diagnosis.json").read_text()
    assert not any(name in text for name in ('"nan"', '"inf"', '"-inf"'))
    written = json.loads(text)
    assert written["ladder"][0]["force_rms_N"] is written["ladder"][1]["deviance"] is None
    assert written["ladder"][0]["force_interval_N"] == [None, None]
    assert written["causes"][0]["evidence"] is None
    assert told["causes"][0]["evidence"] is None  # nor is it another in Python


def test_without_a_controller_it_is_said_why_nothing_is_simulated(tilted, told_of):
    found = dataclasses.replace(tilted, rungs=[one._replace(loop=None) for one in tilted.rungs])
    told, out = told_of(found)
    assert "controller" in told["ladder"][0]["loop_says"]
    assert told["ladder"][0]["loop_says"] in (out / "report.html").read_text()
    assert len(_ladder(found).axes) == 1


def test_of_a_reversed_command_no_cause_is_looked_for_and_no_drive_file_written(tmp_path):
    """A rejected search of minutes, and a drive file that nobody should run."""
    path, drive, out = tmp_path / "reversed.csv", tmp_path / "drive.toml", tmp_path / "out"
    write_log(path, dataclasses.replace(SOUND, command=-moved(SOUND.command, 1)))  # late as well, which is said first
    write_drive(drive, DRIVE)
    out.mkdir()
    for stale in ("augmented.toml", "causes.csv"):
        (out / stale).write_text("of an earlier diagnosis")
    told = command.diagnose_logs([path], drive, out)
    assert told["verdict"] == "unknown"
    assert told["causes"] == []
    assert told["says"].startswith("no cause was looked for: the log checks say of reversed")
    assert "--unit command=-N" in told["next_experiment"]["says"]
    assert "reversed" in told["says"]
    assert not (out / "augmented.toml").exists()
    assert not (out / "causes.csv").exists()
    assert "No cause was looked for" in (out / "report.html").read_text()


def test_a_fatal_finding_lowers_the_confidence_and_is_told(log, tilted, told_of, capsys):
    assert told_of(tilted)[0]["findings"] == []
    late = dataclasses.replace(log, command=moved(log.command, 1))
    told, out = told_of(tilted, late)
    printed = capsys.readouterr().out
    assert "FORCED" not in printed
    assert "1 fatal" in printed
    finding = told["findings"][0]
    assert (finding["severity"], finding["channel"]) == ("fatal", "command")
    assert told["verdict"] == "unknown"
    assert finding["found"] in told["says"]
    assert all(one["confidence"] <= 0.5 for one in told["causes"])
    page = (out / "report.html").read_text()
    assert f"<td>{finding['mend']}</td>" in page
    assert json.loads((out / "diagnosis.json").read_text())["findings"] == told["findings"]


def test_the_withheld_check_doubts_what_the_command_doubts(log, tilted, told_of, tmp_path, monkeypatch):
    late = dataclasses.replace(log, command=moved(log.command, 1))
    told, _ = told_of(tilted, late)
    place = tmp_path / "case"
    place.mkdir()
    write_log(place / "log-a.parquet", late)
    write_drive(place / "drive.toml", DRIVE)
    monkeypatch.setattr(command, "diagnose", lambda *_, **__: tilted)
    answered = answer.answer(place)
    assert [one["severity"] for one in answered["findings"]] == [one["severity"] for one in told["findings"]]
    assert answered["verdict"] == told["verdict"] == "unknown"
    assert answered["says"] == told["says"].replace("of lap:", "of log-a:")
    assert answered["causes"] == told["causes"]


@pytest.mark.parametrize(
    ("resembles", "amount", "verdict"),
    [
        ("loop_delay", -1.0, "effect"),
        ("loop_delay", -2.0, "unknown"),
        ("loop_delay", 1.0, "unknown"),
        ("force_gain", 1.0, "unknown"),
        (None, None, "unknown"),
    ],
)
def test_an_effect_that_a_fatal_finding_resembles_is_told_to_be_the_logs_perhaps(tilted, resembles, amount, verdict):
    """In kind and in size: what the log's fault would not look like is another matter."""
    fatal = [("lap", Finding("fatal", "command", "one sample late", "shift it", resembles, amount))]
    late = SimpleNamespace(model=SimpleNamespace(values=lambda u: [{"delay": np.array([-1.1])}]), u=None)
    belief = tilted.verdict.beliefs[0]._replace(effect="loop_delay", confidence=0.9, fitted=late)
    found = dataclasses.replace(tilted, verdict=tilted.verdict._replace(beliefs=[belief]))
    doubted = command.doubted(found, fatal).verdict
    assert doubted.verdict == verdict
    assert "one sample late" in doubted.says
    assert doubted.beliefs[0].confidence == (0.9 if verdict == "effect" else 0.5)
    assert command.doubted(tilted, fatal).verdict.verdict == "unknown"
    assert command.doubted(tilted, []) is tilted
    assert "mend lap: shift it" in command._mended_first(found, fatal).says
