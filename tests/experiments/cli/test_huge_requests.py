"""Requests for more than any machine has: one line that says what they would take, before anything is done."""

import re
import time

import numpy as np
import pytest
from typer.testing import CliRunner

from diffdrive.errors import ParameterError
from diffdrive.support import resources
from experiments.cli.main import app
from tuning.identification.identify import start_points
from tuning.optimisation.least_squares import multistart
from tuning.optimisation.space import FreeParameter

MOTION = "sine:amplitude=1mm,frequency=5Hz,duration=0.1s"
SECONDS = 20.0  # with what is imported and compiled once


@pytest.fixture
def drive_file(tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(CliRunner().invoke(app, ["template", "--controller", "pd+fc+le"]).output, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def machine_of_8_gb(monkeypatch):
    monkeypatch.setattr(resources, "memory_available", lambda: 8e9)


HUGE = {
    "a motion": ("simulate", ("--motion", "sine:amplitude=1mm,frequency=2Hz,duration=1e6"), r"1e\+10 samples, which"),
    "a load": ("simulate", ("--motion", MOTION, "--load", "1e300"), r"check the units of \[friction\], load and speed"),
    "a seed": ("simulate", ("--seed", str(10**22)), r"--seed: must be a whole number from 0 to 2\^63 - 1, got 1000"),
    "a negative seed": ("tune", ("--seed=-1",), r"--seed: must be a whole number from 0"),
    "samples": (
        "sweep",
        ("--motion", MOTION, "--settle", "0", "--samples", "1000000000"),
        r"samples: 1e\+09 machines, 1e\+09 runs, .* would take about \d+ GB of memory, and 8 GB are free: give fewer",
    ),
    "samples beyond the sequence": (
        "sweep",
        ("--motion", MOTION, "--settle", "0", "--samples", str(2**31)),
        "sobol has 1073741824 machines at most; give fewer, or another method",
    ),
    "a count of 22 digits": ("sweep", ("--samples", str(10**22)), r"--samples: must be less than 2\^63, got 1000"),
    "a sweep's workers": (
        "sweep",
        ("--motion", MOTION, "--settle", "0", "--workers", "1000000000"),
        "workers: 1000000000 processes would take about 300 PB of memory",
    ),
    "settling": ("sweep", ("--motion", MOTION, "--settle", "1e300"), r"1e\+300 s leaves nothing"),
    "a deviation": ("sweep", ("--vary", "plant.mass=lognormal:1e300"), "of a logarithm is too wide"),
    "a range": ("sweep", ("--vary", "plant.mass=uniform:1..1e400 kg"), "is larger than any number"),
    "a gain margin": ("tune", ("--gain-margin", "1e6"), r"--gain-margin 1e\+06: must be at most 313 dB, beyond which"),
    "no gain margin": ("tune", ("--gain-margin", "inf"), "--gain-margin: must be a finite number, got inf"),
    "starts": ("tune", ("--starts", "1000000000"), r"1e\+09 starts would take about 10 TB of memory"),
    "a noise of 400 digits": ("tune", ("--command-noise", "1" * 400), "is larger than any number"),
    "a speed": ("tune", ("--speed", "1e300"), "position leaves|lost in the rounding|floating-point"),
    "a hair's speed": ("tune", ("--speed", "1e-300"), "lost in the rounding|floating-point|check the units"),
}  # fmt: skip
STUDIES = {
    "draws": (("recovery", "--draws", "1000000000"), r"--draws 1e\+09: their results would take about 10 TB of memory"),
    "draws' workers": (
        ("recovery", "--workers", "1000000"),
        r"--workers 1e\+06: as many processes would take about 500 TB",
    ),
    "cases": (("withheld", "--cases", "1000000000"), r"--cases 1e\+09: their logs would write about 200 TB"),
    "cases' workers": (
        ("withheld", "--workers", "1000000"),
        r"--workers 1e\+06: as many processes would take about 2 PB",
    ),
}


def refusal(*arguments):
    began = time.perf_counter()
    answer = CliRunner().invoke(app, [str(one) for one in arguments])
    assert isinstance(answer.exception, ValueError), answer.output
    assert "\n" not in str(answer.exception)
    assert time.perf_counter() - began < SECONDS
    return str(answer.exception)


@pytest.mark.parametrize(("command", "options", "says"), HUGE.values(), ids=HUGE.keys())
@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_a_huge_request_about_a_drive_is_refused(command, options, says, drive_file, tmp_path):
    said = refusal(command, drive_file, *options, "--out", tmp_path / "out")
    assert re.search(says, said), said
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("arguments", "says"), STUDIES.values(), ids=STUDIES.keys())
def test_a_huge_study_is_refused(arguments, says, tmp_path):
    assert re.search(says, refusal(*arguments, "--out", tmp_path / "out"))
    assert not (tmp_path / "out").exists()


def test_starts_that_do_not_fit_are_refused_before_they_are_drawn():
    with pytest.raises(ParameterError, match=r"1e\+12 starts would take about 8 TB of memory"):
        start_points([FreeParameter("mass", 0.1, 10.0)], 10**12, 0)
    with pytest.raises(ParameterError, match=r"from 1000 starts side by side, each with 1000000 residuals, would take"):
        multistart(lambda y, args: np.ones(10**6) * y[0], np.zeros((1000, 1)), None, steps=1)


def test_a_container_counts_where_it_has_less_than_the_machine(monkeypatch, tmp_path):
    monkeypatch.undo()
    of_the_machine = resources.memory_available()
    (tmp_path / "max").write_text("1000000\n")
    (tmp_path / "current").write_text("400000\n")
    for limit, left in (("1000000\n", 600_000.0), ("max\n", None)):
        (tmp_path / "max").write_text(limit)
        monkeypatch.setattr(resources, "_LIMITS", ((str(tmp_path / "max"), str(tmp_path / "current")),))
        found = resources.memory_available()
        assert found == left if left else found > 0.5 * min(of_the_machine, 1e9)
