"""`diffdrive tune` as a user meets it: what it writes, refuses, cannot reach, and that a kill loses nothing."""

import json
import os
import random
import signal
import subprocess
import sys
import time
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import DiffdriveError
from experiments.cli.main import app
from tuning.gains.checkpoint import CHECKPOINT

# an axis at 2 kHz: its programs compile in seconds
DRIVE = """
[plant]
mass = 100.0
damping = [380.0, 260.0]
[friction]
coulomb_screw = [63.43, 64.95]
load_coefficient = 3.66e-4
initial_load = 15200.0
breakaway_gap = [30.0, 22.98]
stribeck_velocity = [0.001, 0.0014]
viscous = [1826.5, 1673.5]
bristle_stiffness = 3.35e7
bristle_damping = 4540.0
[sensor]
resolution = "0.1 um"
[controller]
kind = "pd"
kp = 1.5e6
kd = 8000.0
[sampling]
rate = "2 kHz"
[units]
force_per_volt = 159.593
"""
QUICK = ("--loads", 2, "--machines", 1, "--starts", 2, "--command-noise", "30N")


@pytest.fixture(scope="module")
def drive_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("drive") / "drive.toml"
    path.write_text(DRIVE, encoding="utf-8")
    return path


def tune(*arguments):
    return CliRunner().invoke(app, ["tune", *(str(a) for a in arguments)], catch_exceptions=False)


def numbers(folder):
    return json.loads((folder / "result.json").read_text())


@pytest.fixture(scope="module")
def done(drive_file, tmp_path_factory):
    """A tuning that went through, with a Pareto front."""
    out = tmp_path_factory.mktemp("tuned")
    assert tune(drive_file, *QUICK, "--pareto", "10;30 N", "--out", out).exit_code == 0
    return out


@pytest.mark.long
def test_the_tuned_gains_are_better_and_everything_promised_is_written(done):
    written = numbers(done)
    assert written["verdict"] == {"accepted": True}
    assert written["tuning"]["feasible"]
    before_after = written["mean_rms_um_held_out"]
    assert before_after["after"] < 0.8 * before_after["before"]
    assert {"tuning.png", "nyquist.png", "bode.png", "pareto.png"} == set(written["figures"])
    assert {"gains", "margins", "verification", "pareto"} <= set(written["tables"])
    assert not (done / CHECKPOINT).exists()


@pytest.mark.long
def test_the_hand_over_reads_back_in_newtons_and_in_volts(done):
    handed = tomllib.loads((done / "handover.toml").read_text())
    gains = read_axis(done / "tuned.toml").controller.tracking.gains
    assert handed["gains_si"] == pytest.approx({"kp": float(gains.kp), "kd": float(gains.kd)}, rel=1e-9)
    volts = handed["gains_in_command_volts"]
    assert volts["kp"] == pytest.approx(float(gains.kp) / 159.593, rel=1e-9)
    assert handed["margins_worst"]["gain_up_dB"] >= 6.0 - 0.05
    assert handed["margins_worst"]["phase_deg"] >= 30.0 * (1 - 5e-3)
    assert handed["conditions"]["loads_N"] == [0.0, 12_600.0]


@pytest.mark.long
def test_quieter_costs_tracking(done):
    rows = numbers(done)["tables"]["pareto"]["rows"]
    assert [row[0] for row in rows] == [10.0, 30.0]
    assert rows[0][1] > rows[1][1]
    assert rows[0][3] < rows[1][3]


@pytest.mark.parametrize(
    ("option", "value", "says"),
    [
        ("--speed", "10 kg", "--speed"),
        ("--command-noise", "loud", "--command-noise"),
        ("--max-load", "3 mm", "--max-load"),
        ("--pareto", "5;x N", "--pareto"),
        ("--aggregation", "median", "no aggregation 'median'; known: mean, worst, cvar"),
        ("--speed", "0 mm/s", "speed"),
        ("--max-load", "-90 kN", "load"),
        ("--command-noise", "-3 N", "--command-noise -3 N: must be 0 or more"),
        ("--load-error", "-1 N", "--load-error -1 N: must be 0 or more"),
        ("--load-error", "100 N", "load_error: this controller estimates no load"),
        ("--spread", "60%", "spread 60%: give a share from 0 to 50%, as 3% or 0.03"),
        ("--command-noise", "0 N", "command_noise: must be above 0 N"),
    ],
)
def test_a_bad_option_is_named(drive_file, option, value, says):
    with pytest.raises(DiffdriveError, match=says):
        tune(drive_file, *QUICK, option, value)


@pytest.mark.long
def test_what_cannot_be_kept_ends_with_3_and_writes_no_drive(drive_file, tmp_path):
    result = tune(drive_file, *QUICK, "--command-noise", "0.01N", "--out", tmp_path)
    assert result.exit_code == 3
    assert "NOT KEPT: command noise, missed by" in result.output
    assert not (tmp_path / "tuned.toml").exists()
    assert numbers(tmp_path)["verdict"] == {"accepted": False}


@pytest.mark.slow
@pytest.mark.parametrize("extra", [("--aggregation", "worst"), ("--aggregation", "cvar", "--peak", "0.5")])
def test_other_objectives(drive_file, tmp_path, extra):
    assert tune(drive_file, *QUICK, *extra, "--starts", 1, "--out", tmp_path).exit_code == 0
    assert numbers(tmp_path)["tuning"]["objective"] < numbers(tmp_path)["tuning"]["objective_before"]


@pytest.mark.long
@pytest.mark.skipif(os.name == "nt", reason="a kill that cannot be caught is a POSIX signal")
def test_killed_at_a_random_moment_and_resumed_it_ends_where_it_would_have(drive_file, done, tmp_path):
    """The same gains to 1e-9 as the run that was left alone."""
    out = tmp_path / "killed"
    arguments = ["tune", str(drive_file), *(str(a) for a in QUICK), "--out", str(out)]
    command = [sys.executable, "-c", "from experiments.cli.main import main; main()", *arguments]
    delay = random.uniform(0.0, 0.6)
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    try:
        while process.poll() is None and not (out / CHECKPOINT).exists():
            time.sleep(0.01)
        time.sleep(delay)
    finally:
        process.send_signal(signal.SIGKILL)
        message = process.communicate()[1]
    assert process.returncode == -signal.SIGKILL, (delay, message)
    standings = json.loads((out / CHECKPOINT).read_text())["standings"]
    assert sum(one["steps"] for one in standings.values()) >= 1
    resumed = subprocess.run(command, capture_output=True, check=False)
    assert resumed.returncode == 0, resumed.stderr
    ours, theirs = (np.array([row[2] for row in numbers(folder)["tables"]["gains"]["rows"]]) for folder in (out, done))
    np.testing.assert_allclose(ours, theirs, rtol=1e-9, err_msg=f"killed {delay} s after the first step")
    assert numbers(out)["tuning"]["steps"] == numbers(done)["tuning"]["steps"]
