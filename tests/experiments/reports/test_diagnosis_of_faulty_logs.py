"""What `diffdrive diagnose` makes of logs that the checks find a fatal fault in."""

import dataclasses
import json
import re
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.logs import write_log
from diffdrive.logs.checks.examine import Finding
from experiments.reports.diagnosis import diagnosis as command
from experiments.studies.withheld import answer
from tests.support import constant_force_log
from tests.support.sound_log import DRIVE, SOUND, delayed
from tuning.checked_logs import CheckedLogs
from tuning.diagnosis.workflow import downgrade, next_motion_of


@pytest.mark.long
def test_a_fatal_finding_is_mended_before_any_motion(constant_force_diagnosis, command_for, monkeypatch):
    fatal = [("lap", Finding("fatal", "position", "steps", "give the unit"))]
    monkeypatch.setattr(command, "read_diagnosis_logs", lambda *_: CheckedLogs((), tuple(fatal)))
    monkeypatch.setattr(command, "save_diagnosis_figures", lambda *_: None)
    told, _ = command_for(constant_force_diagnosis)
    assert told["next_experiment"]["says"] == "Before any motion, correct lap: give the unit."


@pytest.mark.long
def test_of_a_reversed_command_no_cause_is_looked_for_and_no_drive_file_written(tmp_path):
    """A rejected search of minutes, and a drive file that nobody should run."""
    path, drive, out = tmp_path / "reversed.csv", tmp_path / "drive.toml", tmp_path / "out"
    write_log(path, dataclasses.replace(SOUND, command=-delayed(SOUND.command, 1)))  # late as well, which is said first
    write_axis(drive, DRIVE)
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
    status = json.loads((out / "diagnosis.json").read_text())["status"]
    assert (status["ok"], status["code"]) == (False, "void")


@pytest.mark.long
def test_a_fatal_finding_lowers_the_confidence_and_is_told(constant_force_diagnosis, command_for, capsys):
    assert command_for(constant_force_diagnosis)[0]["findings"] == []
    late = dataclasses.replace(constant_force_log.log(), command=delayed(constant_force_log.log().command, 1))
    told, out = command_for(constant_force_diagnosis, late)
    printed = capsys.readouterr().out
    assert "overruled" not in printed
    assert "1 fatal" in printed
    finding = told["findings"][0]
    assert (finding["severity"], finding["channel"]) == ("fatal", "command")
    assert told["verdict"] == "unknown"
    assert finding["found"] in told["says"]
    assert all(one["confidence"] <= 0.5 for one in told["causes"])
    page = (out / "report.html").read_text()
    assert f"<td>{finding['mend']}</td>" in unescape(page)
    assert json.loads((out / "diagnosis.json").read_text())["findings"] == told["findings"]


@pytest.mark.long
def test_the_withheld_check_doubts_what_the_command_doubts(
    constant_force_diagnosis, command_for, tmp_path, monkeypatch
):
    late = dataclasses.replace(constant_force_log.log(), command=delayed(constant_force_log.log().command, 1))
    told, _ = command_for(constant_force_diagnosis, late)
    place = tmp_path / "case"
    place.mkdir()
    write_log(place / "log-a.parquet", late)
    write_axis(place / "drive.toml", DRIVE)
    monkeypatch.setattr("tuning.diagnosis.workflow.diagnose_drive", lambda *_, **__: constant_force_diagnosis)
    answered = answer.diagnose_case(place)
    assert [one["severity"] for one in answered["findings"]] == [one["severity"] for one in told["findings"]]
    assert answered["verdict"] == told["verdict"] == "unknown"
    assert answered["says"] == re.sub(r"\blap:", "log-a:", told["says"])
    assert answered["causes"] == told["causes"]


@pytest.mark.long
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
def test_an_effect_that_a_fatal_finding_resembles_is_told_to_be_the_logs_perhaps(
    constant_force_diagnosis, resembles, amount, verdict
):
    """In kind and in size: what the log's fault would not look like is another matter."""
    finding = Finding("fatal", "command", "one sample late", "shift it", "shifted", resembles=resembles, amount=amount)
    fatal = [("lap", finding)]
    late = SimpleNamespace(model=SimpleNamespace(values=lambda _: [{"delay": np.array([-1.1])}]), theta=None)
    belief = constant_force_diagnosis.verdict.beliefs[0]._replace(effect="loop_delay", confidence=0.9, fitted=late)
    found = dataclasses.replace(
        constant_force_diagnosis, verdict=constant_force_diagnosis.verdict._replace(beliefs=[belief])
    )
    doubted = downgrade(found, fatal).verdict
    assert doubted.verdict == verdict
    assert "one sample late" in doubted.says
    assert doubted.beliefs[0].confidence == (0.9 if verdict == "effect" else 0.5)
    assert downgrade(constant_force_diagnosis, fatal).verdict.verdict == "unknown"
    assert downgrade(constant_force_diagnosis, []) is constant_force_diagnosis
    assert "correct lap: shift it" in next_motion_of(DRIVE, CheckedLogs((), tuple(fatal)), found).says
