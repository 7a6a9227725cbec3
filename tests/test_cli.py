"""The command line as a user meets it."""

import json
import os
import subprocess
import sys

import pytest
from typer.testing import CliRunner

from diffdrive.drive_file import read_drive
from experiments.cli import app

SHORT = "triangular:speed=10mm/s,stroke=2mm,rounding=0.05s,duration=0.3s"


@pytest.fixture
def drive_file(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(CliRunner().invoke(app, ["template"]).output, encoding="utf-8")
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments], catch_exceptions=False)


def numbers(folder):
    return json.loads((folder / "result.json").read_text())


def test_help_names_every_command():
    shown = run("--help").output
    commands = "demo simulate identify tune sweep replay convergence reproduce bench template keys"
    for command in commands.split():
        assert command in shown
        assert run(command, "--help").exit_code == 0


def test_the_template_is_a_drive_file(drive_file):
    assert float(read_drive(drive_file).drive.plant.mass) == 100.0


@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_simulate_writes_what_it_prints(drive_file, tmp_path):
    out = tmp_path / "out"
    assert run("simulate", drive_file, "--motion", SHORT, "--load", "2kN", "--out", out).exit_code == 0
    written = numbers(out)
    assert written["run"]["status"] == "ok"
    assert 0 < written["result"]["rms_error_um"] < 1
    assert (out / "run.png").is_file()
    header, first = (out / "run.csv").read_text().splitlines()[:2]
    assert header.startswith("time,reference,position")
    assert len(first.split(",")) == len(header.split(","))


@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_simulate_says_what_diverged_and_ends_with_3(drive_file):
    drive_file.write_text(drive_file.read_text().replace("kd = 15959.29", "kd = 1.6e7"))
    result = run("simulate", drive_file, "--motion", SHORT)
    assert result.exit_code == 3
    assert "diverged: " in result.output
    assert "t = 0.0" in result.output


@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_simulate_a_machine_that_differs_from_the_model(drive_file, tmp_path):
    machine = tmp_path / "machine.toml"
    machine.write_text(drive_file.read_text().replace("mass = 100.0 ", "mass = 130.0 "))
    for name, extra in (("same", ()), ("other", ("--machine", machine))):
        assert run("simulate", drive_file, "--motion", SHORT, *extra, "--out", tmp_path / name).exit_code == 0
    assert numbers(tmp_path / "other")["result"] != numbers(tmp_path / "same")["result"]


def test_convergence_ends_with_3_where_eq_20_diverges(drive_file, tmp_path):
    good = run("convergence", drive_file, "--speeds", "10;40 mm/s", "--out", tmp_path / "good")
    bad = run("convergence", drive_file, "--speeds", "10;15 mm/s")
    assert (good.exit_code, bad.exit_code) == (0, 3)
    assert "DIVERGES" in bad.output
    assert numbers(tmp_path / "good")["tables"]["convergence"]["rows"][0][1] == pytest.approx(0.0174, rel=0.01)


def test_an_expected_error_is_one_line_and_code_2(drive_file):
    drive_file.write_text(drive_file.read_text().replace("mass = 100.0", 'mass = "100 mm"'))
    command = [sys.executable, "-c", "from experiments.cli import main; main()", "simulate", str(drive_file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "error: " in done.stderr
    assert "[plant] mass" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="a POSIX signal")
def test_whoever_is_ended_loses_no_more_than_by_an_interrupt():
    ended = "import os, signal; from experiments import cli; cli.app = lambda: os.kill(os.getpid(), signal.SIGTERM); "
    run = subprocess.run([sys.executable, "-c", ended + "cli.main()"], capture_output=True, text=True, check=False)
    assert run.returncode == 130
    assert "what was written so far stays" in run.stderr
