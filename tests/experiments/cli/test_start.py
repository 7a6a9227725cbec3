"""`diffdrive start` as a stranger meets it: three commands from a CSV, one line where something is not known."""

import json

import pytest

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import ParameterError
from experiments.reports.start import start_from_trace
from tests.support.command_line import refused, run
from tests.tuning.unknown_trace.test_start import COLUMNS, written_csv

OPTIONS = ("--mass", "110kg", "--lead", "10mm", "--rated-torque", "5Nm")


@pytest.fixture
def trace(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return written_csv(tmp_path / "my trace.csv", COLUMNS)


def test_it_writes_a_drive_file_checks_with_it_and_says_how_to_go_on(trace, tmp_path):
    done = run("start", trace.name, *OPTIONS, "--out", "look")
    assert done.exit_code == 0
    assert "No findings" in done.output
    assert "Next: diffdrive identify 'my trace.csv' --drive drive.toml --out found" in done.output
    assert "command: 'Momentensollwert [%]' (sure: its name" in done.output
    assert read_axis("drive.toml").value("plant.mass") == 110.0
    assert json.loads((tmp_path / "look" / "result.json").read_text())["verdict"] == {"fatal": 0, "findings": 0}
    assert run("check", trace.name, "--drive", "drive.toml").exit_code == 0


def test_an_existing_file_is_refused_before_anything_is_read(trace, tmp_path):
    (tmp_path / "drive.toml").write_text("mine")
    assert "exists, and is not overwritten" in refused("start", "no such file.csv", *OPTIONS)
    assert (tmp_path / "drive.toml").read_text() == "mine"


def test_without_a_terminal_nothing_is_asked(trace, tmp_path):
    said = refused("start", trace.name, "--mass", "110kg")
    assert '--lead "10 mm"' in said
    assert '--rated-torque "5 N*m"' in said
    assert not (tmp_path / "drive.toml").exists()


def test_at_a_terminal_what_is_open_is_asked_and_answered(trace, tmp_path):
    answers = {"mass": "110 kg", "lead": "10 mm", "rated_torque": "5 Nm"}
    asked = []

    def ask(question):
        asked.append(question.argument)
        return answers[question.argument]

    assert start_from_trace(trace, tmp_path / "asked.toml", None, numbers={}, ask=ask)
    assert sorted(asked) == sorted(answers)
    assert read_axis(tmp_path / "asked.toml").value("plant.mass") == 110.0


def test_an_answer_that_does_not_answer_is_no_endless_dialogue(tmp_path):
    unnamed = {name.removesuffix(" [mm]"): values for name, values in COLUMNS.items()}
    trace = written_csv(tmp_path / "trace.csv", unnamed)
    numbers = {"mass": "110 kg", "lead": "10 mm", "rated_torque": "5 Nm"}
    with pytest.raises(ParameterError, match="'V' is no unit of the position"):
        start_from_trace(trace, tmp_path / "asked.toml", None, numbers=numbers, ask=lambda _: "V")
