"""`diffdrive check`: what logs hold, and which finding of theirs is fatal."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.logs import write_log
from experiments.cli.main import app
from tests.support.sound_log import DRIVE, RATE, SOUND, delayed, replaced


@pytest.fixture
def checked(tmp_path):
    """Exit code and result of a look at a log."""

    def check(log, *options):
        write_axis(tmp_path / "drive.toml", DRIVE)
        write_log(tmp_path / "lap.csv", log)
        given = [str(tmp_path / one) for one in ("lap.csv", "drive.toml", "out")]
        found = CliRunner().invoke(app, ["check", given[0], "--drive", given[1], "--out", given[2], *options])
        return found.exit_code, json.loads((tmp_path / "out" / "result.json").read_text())

    return check


def test_a_sound_log_is_said_to_be_so_and_what_it_holds(checked):
    code, told = checked(SOUND)
    assert code == 0
    assert told["verdict"]["fatal"] == 0
    (row,) = told["tables"]["logs"]["rows"]
    held = dict(zip(told["tables"]["logs"]["columns"], row, strict=True))
    assert (held["log"], held["samples"], held["gaps"]) == ("lap", len(SOUND.time), 0)
    assert held["rate Hz"] == pytest.approx(RATE)
    assert (held["from mm"], held["to mm"]) == pytest.approx((1e3 * SOUND.position.min(), 1e3 * SOUND.position.max()))
    # two sines: 20 mm at 0.6 Hz and 3 mm at 1.9 Hz, whose speeds add up nearly once
    assert 80.0 < held["fastest mm/s"] < 2 * 3.1416 * (20 * 0.6 + 3 * 1.9)
    assert held["channels"] == "reference position command"


def test_the_option_that_a_finding_names_mends_that_log_and_no_other(tmp_path):
    """Two logs of one call, one of them late; and a name that is none of theirs is refused."""
    write_axis(tmp_path / "drive.toml", DRIVE)
    write_log(tmp_path / "in_time.csv", SOUND)
    write_log(tmp_path / "late.csv", replaced(command=delayed(SOUND.command, 1)))
    given = ["check", *(str(tmp_path / one) for one in ("in_time.csv", "late.csv")), "--drive"]
    given += [str(tmp_path / "drive.toml"), "--out", str(tmp_path / "out")]
    assert CliRunner().invoke(app, given).exit_code == 3
    rows = json.loads((tmp_path / "out" / "result.json").read_text())["tables"]["findings"]["rows"]
    ((log, mend),) = [(row[0], row[4]) for row in rows if row[1] == "fatal"]
    assert log == "late"
    option = re.findall(r"--shift (\S+?)[,)]", mend)[0]
    assert CliRunner().invoke(app, [*given, "--shift", option]).exit_code == 0
    refused = CliRunner().invoke(app, [*given, "--shift", "later:command=-1"])
    assert "later:command=-1: no such log; the logs are in_time.csv, late.csv" in str(refused.exception)


def test_a_fatal_finding_is_named_with_its_mend_and_ends_with_3(checked):
    code, told = checked(replaced(command=delayed(SOUND.command, 1)))
    assert code == 3
    assert told["verdict"]["fatal"] == 1
    worst = [row for row in told["tables"]["findings"]["rows"] if row[1] == "fatal"]
    assert len(worst) == 1
    assert worst[0][2] == "command"
    assert "shift the command by -1 samples" in worst[0][4]


def test_two_encoders_have_a_table_and_a_picture(checked, tmp_path):
    """The motor 40 um ahead of the table in either direction: 80 um of lost motion."""
    turned = np.where(np.gradient(SOUND.position) < 0.0, -1.0, 1.0)
    code, told = checked(replaced(motor_position=SOUND.position + 40e-6 * turned), "--svg", "--pdf")
    assert code == 0
    rows = {row[1]: row[2:] for row in told["tables"]["encoders"]["rows"]}
    value, low, high, unit = rows["reversal error"]
    assert (value, unit) == (pytest.approx(80.0, rel=0.01), "um")
    assert low <= value <= high
    assert (tmp_path / "out" / "encoders.csv").exists()
    assert told["figures"] == [f"encoders.{ending}" for ending in ("png", "svg", "pdf")]
    assert all((tmp_path / "out" / name).exists() for name in told["figures"])
    assert any("lost motion" in row[3] for row in told["tables"]["findings"]["rows"])
