"""What `diffdrive identify` is told of its logs and what it refuses, before it searches."""

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import LogError, MotionError, ParameterError
from diffdrive.logs import read_log, write_log
from experiments.cli.main import app
from experiments.reports.checked_logs import parse_loads, read_sound_logs
from experiments.reports.identification.identification import parse_bounds
from experiments.reports.report import Report
from tests.support.identify_command import MOTION, TRUE, run
from tests.support.sound_log import simulate_log

FAULTS = {
    "no such parameter": (("--fixed", "mas"), r"--fixed mas: no such parameter; did you mean 'mass'"),
    "no such bound": (("--bound", "mas=1:2"), r"--bound mas: no such parameter"),
    "half a bound": (("--bound", "mass=80"), r"--bound mass=80: write NAME=LOW:HIGH"),
    "bounds reversed": (("--bound", "mass=120:80"), r"--bound mass=120:80: the lower end must be below"),
    "bounded twice": (("--bound", "mass=8:9", "--bound", "mass=9:10"), r"mass is bounded twice"),
    "load of no log": (("--load", "lop.csv=8kN"), r"--load lop.csv=8kN: no such log; did you mean 'lap.csv'\?"),
    "load of what log": (("--load", "8kN"), r"--load 8kN: write LOG=FORCE, such as lap.csv=8kN"),
    "load without a number": (("--load", "lap.csv=heavy"), r"--load lap.csv=heavy: "),
    "loaded twice": (("--load", "lap.csv=8kN", "--load", "lap.csv=9kN"), r"lap.csv is given two loads"),
    "no such channel": (("--column", "positon=qm"), r"positon: no such channel; did you mean 'position'"),
    "no such column": (("--column", "position=qm"), r"qm"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_bad_options_are_refused_in_one_line(name, folder):
    options, said = FAULTS[name]
    with pytest.raises((ParameterError, LogError, MotionError), match=said) as caught:
        run(folder / "lap.csv", "--drive", folder / "drive.toml", *options)
    assert "\n" not in str(caught.value)


def test_a_log_without_a_column_for_its_load_is_told_it(folder, tmp_path):
    with Report("loads", tmp_path) as report:
        paths = [folder / "lap.csv", folder / "other.csv"]
        given = parse_loads(["other=8kN"], paths)
        lap, other = read_sound_logs(paths, TRUE, report, name="findings", force=False, loads=given).logs
        assert lap.load is None
        assert np.all(other.load == 8e3)
        loaded = tmp_path / "loaded.csv"
        write_log(loaded, other)
        with pytest.raises(LogError, match="has a load of its own"):
            read_sound_logs([loaded], TRUE, report, name="more", force=False, loads={loaded: 1.0})


def test_a_bound_may_carry_its_unit():
    assert parse_bounds(["bristle_stiffness=20 N/um:50N/um"]) == {"friction.bristle_stiffness": (2e7, 5e7)}
    assert parse_bounds(["actuator.delay=0:2"]) == {"actuator.delay": (0.0, 2.0)}


def test_a_log_that_is_none_is_refused(folder):
    (folder / "empty.csv").write_text("time,position\n")
    with pytest.raises(LogError, match=r"empty\.csv"):
        run(folder / "empty.csv", "--drive", folder / "drive.toml")
    with pytest.raises(LogError, match=r"nowhere\.csv: no such file"):
        run(folder / "nowhere.csv", "--drive", folder / "drive.toml")


def test_a_log_at_another_rate_is_refused(folder, tmp_path):
    log = simulate_log(TRUE, MOTION)
    slower = {name: values[::2] for name, values in log.channels.items()}
    write_log(tmp_path / "slow.csv", dataclasses.replace(log, **slower))
    with pytest.raises(LogError, match=r"slow\.csv: is sampled at 1000 Hz, .* runs at 2000 Hz: log every sample"):
        run(tmp_path / "slow.csv", "--drive", folder / "drive.toml")


def test_a_log_that_is_given_twice_is_refused(folder, tmp_path):
    drive = ("--drive", folder / "drive.toml")
    copy = tmp_path / "another_day.csv"
    copy.write_bytes((folder / "lap.csv").read_bytes())
    with pytest.raises(LogError, match=r"lap\.csv: is given twice; give each log once"):
        run(folder / "lap.csv", folder / "other.csv", tmp_path / ".." / folder.name / "lap.csv", *drive)
    with pytest.raises(LogError, match=r"another_day\.csv: holds the same samples as lap; give each log once"):
        run(folder / "lap.csv", copy, *drive)
    for again in (folder / "lap.csv", copy):
        with pytest.raises(LogError, match=rf"{again.name}: holds the same samples as lap; .* hold out one of another"):
            run(folder / "lap.csv", *drive, "--held-out", again)


def cut(folder, name, rows):
    """A log of the first rows, in SI units."""
    log = simulate_log(TRUE, MOTION)
    write_log(folder / name, dataclasses.replace(log, **{k: values[:rows] for k, values in log.channels.items()}))
    return folder / name


def test_too_short_a_log_is_told_how_long_it_must_be(folder, tmp_path):
    """No --force helps: fewer samples in a row than that are never used."""
    short = cut(tmp_path, "short.csv", 199)
    told = r"short\.csv: has at most 199 samples in a row without a gap; at least 200 are needed, 0\.1 s at 2000 Hz"
    for logs in ([short], [folder / "lap.csv", "--held-out", short]):
        with pytest.raises(LogError, match=told) as refused:
            run(*logs, "--drive", folder / "drive.toml", "--force")
        assert "force" not in str(refused.value)
        assert "log a longer motion" in str(refused.value)
    with Report("long enough", None) as report:
        read_sound_logs([cut(tmp_path, "enough.csv", 200)], TRUE, report, name="findings", force=True)


def test_a_simulated_run_needs_no_unit_beside_a_force_per_volt(folder, tmp_path):
    drive = tmp_path / "volts.toml"
    drive.write_text((folder / "drive.toml").read_text() + "\n[units]\nforce_per_volt = 159.593\n")
    motion = "sine:amplitude=2mm,frequency=2Hz,duration=0.5s"
    simulate = ["simulate", str(drive), "--motion", motion, "--out", str(tmp_path / "run")]
    assert CliRunner().invoke(app, simulate).exit_code == 0
    with Report("simulated", None) as report:
        (log,) = read_sound_logs(
            [tmp_path / "run" / "run.csv"], read_axis(drive), report, name="findings", force=False
        ).logs
    assert np.array_equal(log.command, read_log(tmp_path / "run" / "run.csv").command)
