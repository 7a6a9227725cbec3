"""`diffdrive axes`, and the axes of the library by name in every command that takes a drive file."""

import json

import platformdirs
import pytest

import diffdrive as dd
from diffdrive.library import OWN_FOLDER
from diffdrive.library.search import FOLDERS
from diffdrive.logs import write_log
from tests.support.command_line import SHORT, refused, run

WRONG = "gantri: no such file, and no axis of the library; did you mean 'gantry'?"


@pytest.fixture(autouse=True)
def working_folder(tmp_path, monkeypatch):
    """An empty one, and a library of the package's axes alone."""
    monkeypatch.delenv(FOLDERS, raising=False)
    monkeypatch.setattr(platformdirs, "user_config_dir", lambda *_, **__: str(tmp_path / "config"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_it_lists_each_axis_with_its_controller_rate_and_source():
    lines = run("axes").output.splitlines()
    rows = {cells[0]: cells for cells in ([cell.strip() for cell in line.split("|")[1:-1]] for line in lines)}
    assert rows["name"] == ["name", "axis", "controller", "rate", "source"]
    for name, one in dd.axes().items():
        axis = dd.read_axis(name)
        assert rows[name][1] == one.provenance.title
        assert rows[name][2:4] == [axis.controller.kind, f"{axis.rate / 1000:g} kHz"]
        assert rows[name][4] == one.provenance.source


@pytest.mark.parametrize("name", sorted(path.stem for path in OWN_FOLDER.glob("*.toml")))
def test_it_prints_the_file_of_one_or_writes_it(name, working_folder):
    text = (OWN_FOLDER / f"{name}.toml").read_text(encoding="utf-8")
    assert run("axes", name).output == text
    assert run("axes", name, "--out", "out").exit_code == 0
    assert (working_folder / "out" / f"{name}.toml").read_text(encoding="utf-8") == text
    assert dd.read_axis(working_folder / "out" / f"{name}.toml").parameters == dd.read_axis(name).parameters


def test_it_writes_the_list(working_folder):
    run("axes", "--out", "out")
    assert (working_folder / "out" / "axes.md").read_text(encoding="utf-8") == run("axes").output
    assert json.loads((working_folder / "out" / "result.json").read_text())["written"] == {"file": "axes.md"}


def test_a_wrong_name_is_refused_with_what_may_be_meant():
    assert refused("axes", "gantri") == "gantri: no axis of the library; did you mean 'gantry'?"
    assert refused("axes", "xyz") == "xyz: no axis of the library; known: cnc, emps, gantry, linear, paper, vertical"


@pytest.mark.parametrize(
    "arguments",
    [
        ("simulate", "gantri"),
        ("simulate", "gantry", "--machine", "gantri"),
        ("margins", "gantri"),
        ("severity", "gantri"),
        ("tune", "gantri"),
        ("export", "gantri", "--out", "out"),
        ("sweep", "gantri"),
        ("sweep", "gantry", "--machine", "gantri"),
        ("sweep", "gantry", "--against", "gantri"),
        ("convergence", "gantri"),
        ("check", "lap.csv", "--drive", "gantri"),
        ("identify", "lap.csv", "--drive", "gantri"),
        ("diagnose", "lap.csv", "--drive", "gantri"),
        ("compare", "lap.csv", "--", "lap.csv", "--drive", "gantri"),
    ],
    ids=" ".join,
)
def test_every_command_looks_for_the_name_in_the_library(arguments):
    assert refused(*arguments) == WRONG


def test_a_name_does_what_its_file_does(working_folder):
    """A run, and its log read back and checked."""
    results = []
    for number, drive in enumerate(("linear", OWN_FOLDER / "linear.toml")):
        out = working_folder / str(number)
        assert run("simulate", drive, "--motion", SHORT, "--machine", drive, "--out", out).exit_code == 0
        results.append(json.loads((out / "result.json").read_text())["result"])
    assert results[0] == results[1]
    assert run("margins", "linear").exit_code == 0
    checked = run("check", working_folder / "0" / "run.csv", "--drive", "linear")
    assert checked.exit_code == 0, checked.output


def test_an_axis_is_swept_against_another_by_their_names(working_folder):
    motion = "sine:amplitude=1mm,frequency=5Hz,duration=0.2s"
    done = run(
        "sweep", "gantry", "--against", "vertical", "--samples", 8, "--motion", motion, "--settle", 0.1, "--out", "out"
    )
    assert done.exit_code == 0, done.output
    varied = (working_folder / "out" / "varied.csv").read_text()
    assert all(path in varied for path in dd.read_axis("gantry").uncertainty.names)  # which the file's table says


def test_a_log_of_an_axis_is_read_by_its_name(working_folder):
    axis = dd.read_axis("gantry")
    motion = dd.motion.sine(amplitude=5e-3, frequency=2.0, duration=1.0, rate=axis.rate)
    write_log(working_folder / "lap.csv", dd.simulate(axis, motion).log())
    done = run("check", "lap.csv", "--drive", "gantry")
    assert done.exit_code == 0, done.output
