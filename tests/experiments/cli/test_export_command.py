"""`diffdrive export` from the command line: what it writes and says, and what it refuses in one line."""

import json
import re

import pytest
from typer.testing import CliRunner

from experiments.cli.main import app
from experiments.exports.program import ExportError

MOTION = "sine:amplitude=1mm,frequency=20Hz,duration=0.1s"


def exported(*arguments):
    return CliRunner().invoke(app, ["export", *map(str, arguments), "--motion", MOTION])


@pytest.fixture
def drive(tmp_path):
    (tmp_path / "my axis.toml").write_text(CliRunner().invoke(app, ["template", "--controller", "cascade"]).output)
    return tmp_path / "my axis.toml"


def test_files_are_named_by_the_drive_file_and_the_result_says_how_far_they_agree(drive, tmp_path):
    run = exported(drive, "--out", tmp_path / "code")
    assert run.exit_code == 0, run.output
    result = json.loads((tmp_path / "code" / "result.json").read_text())["result"]
    assert "my_axis.c" in result["files"]
    assert (tmp_path / "code" / "my_axis_run.csv").read_text().startswith("reference_position,")
    for difference in result["relative_differences"].values():  # none without a compiler
        assert difference < 1e-9
    assert "my_axis_bench" in run.output


def test_single_precision_is_told_beside_the_resolution_of_the_scale(drive, tmp_path):
    run = exported(drive, "--out", tmp_path / "code", "--target", "structured-text", "--precision", "single")
    assert run.exit_code == 0, run.output
    assert re.search(r"has steps of [\d.]+ nm; the scale has 100 nm", " ".join(run.output.split()))


@pytest.mark.parametrize(
    ("option", "value", "message"),
    [("--target", "ladder", "c99"), ("--name", "int", "name"), ("--precision", "half", "single")],
)
def test_what_is_not_known_is_refused_and_writes_no_code(drive, tmp_path, option, value, message):
    run = exported(drive, "--out", tmp_path / "code", option, value)
    assert run.exit_code != 0
    assert message in str(run.exception)
    assert not list((tmp_path / "code").glob("*.c"))


def test_an_unknown_controller_is_refused(drive, tmp_path):
    text = re.sub(r"\[controller\].*?(?=\n\[)", '[controller]\nkind = "unknown"\n', drive.read_text(), flags=re.S)
    drive.write_text(text)
    run = exported(drive, "--out", tmp_path / "code")
    assert isinstance(run.exception, ExportError)


HOSTILE = ("*/ int x; /*", "*) x := 1; (*", '"; DROP', "<script>alert(1)</script>", "{{ 7*7 }}", "a\u202eb", "é" * 60)


@pytest.mark.parametrize("target", ["c99", "structured-text", "fmu", "hal"])
@pytest.mark.parametrize("name", HOSTILE)
def test_no_file_name_reaches_the_code_as_more_than_a_comment(drive, tmp_path, target, name):
    other = drive.with_name(f"{name.replace('/', '_')}.toml")
    drive.rename(other)
    run = exported(other, "--out", tmp_path / "code", "--target", target)
    assert run.exit_code == 0, run.output
    for file in (tmp_path / "code").iterdir():
        assert re.fullmatch(r"[a-z][a-z0-9_]*\.\w+", file.name)
