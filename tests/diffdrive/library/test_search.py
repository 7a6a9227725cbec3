"""Axes by name: which file is meant, where further ones are found, and what is refused."""

import os
from pathlib import Path

import pytest

import diffdrive as dd
from diffdrive.errors import DriveFileError
from diffdrive.library import OWN_FOLDER
from diffdrive.library.listing import library_axis, markdown
from diffdrive.library.search import FOLDERS

CNC = (OWN_FOLDER / "cnc.toml").read_text(encoding="utf-8")
HEAVY = CNC.replace("mass = 450.0 ", "mass = 500.0 ")


def kept(folder, name, text=HEAVY):
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.toml"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture
def working_folder(tmp_path, monkeypatch):
    folder = tmp_path / "working"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.mark.parametrize("given", ["cnc", Path("cnc")])
def test_a_name_is_an_axis_of_the_library(working_folder, given):
    axis = dd.read_axis(given)
    assert axis.name == "cnc"
    assert axis.parameters == dd.read_axis(OWN_FOLDER / "cnc.toml").parameters


def test_a_file_of_that_name_wins(working_folder):
    (working_folder / "cnc").write_text(HEAVY, encoding="utf-8")
    assert dd.read_axis("cnc").value("plant.mass") == 500.0


def test_a_folder_of_that_name_does_not(working_folder):
    (working_folder / "cnc").mkdir()
    assert dd.read_axis("cnc").value("plant.mass") == 450.0
    (working_folder / "swept").mkdir()
    with pytest.raises(DriveFileError, match=r"^swept: is a folder, not a file$"):
        dd.read_axis("swept")


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("gantri", "gantri: no such file, and no axis of the library; did you mean 'gantry'?"),
        ("Gantry", "Gantry: no such file, and no axis of the library; did you mean 'gantry'?"),
        ("xyz", "xyz: no such file, and no axis of the library; known: cnc, emps, gantry, linear, paper, vertical"),
        ("cnc.toml", "cnc.toml: no such file; 'cnc' without .toml is an axis of the library"),
        ("mine.toml", "mine.toml: no such file; 'diffdrive template > drive.toml' writes one to start from"),
        (os.path.join("axes", "cnc"), "no such file; 'diffdrive template > drive.toml' writes one to start from"),
        ("c\0nc", "no axis of the library"),
        ("c" * 5000, "no axis of the library"),
        ("", "is a folder"),
        ("..", "is a folder"),
    ],
)  # fmt: skip
def test_what_is_neither_a_file_nor_an_axis_is_refused_in_one_line(working_folder, given, told):
    with pytest.raises(DriveFileError) as problem:
        dd.read_axis(given)
    assert told in str(problem.value)
    assert "\n" not in str(problem.value)
    assert len(str(problem.value)) < 250


def test_the_users_own_folder_is_searched(working_folder, own_folder):
    assert "mill" not in dd.axes()
    path = kept(own_folder, "mill")
    assert dd.axes()["mill"].path == path
    assert dd.read_axis("mill").value("plant.mass") == 500.0
    assert dd.read_axis("mill").name == "mill"


def test_folders_that_the_environment_names_are_searched_too(working_folder, own_folder, tmp_path, monkeypatch):
    paths = [kept(tmp_path / name, name) for name in ("one", "other")]
    kept(own_folder, "mill")
    monkeypatch.setenv(FOLDERS, os.pathsep.join(["", *(str(path.parent) for path in paths), str(paths[0].parent)]))
    assert [name for name in dd.axes() if name not in ("cnc", "emps", "gantry", "linear", "paper", "vertical")] == [
        "one", "other", "mill",
    ]  # fmt: skip
    assert dd.axes()["other"].read().value("plant.mass") == 500.0


def test_a_folder_that_is_not_there_is_not_passed_over(working_folder, tmp_path, monkeypatch):
    monkeypatch.setenv(FOLDERS, str(tmp_path / "nowhere"))
    with pytest.raises(DriveFileError, match=r"^DIFFDRIVE_AXES: .*nowhere: no such folder"):
        dd.axes()
    with pytest.raises(DriveFileError, match=r"^DIFFDRIVE_AXES: "):
        dd.read_axis("cnc")
    assert dd.read_axis(OWN_FOLDER / "cnc.toml").name == "cnc"  # a file is read whatever the library holds


def test_a_name_of_two_axes_is_no_name(working_folder, own_folder):
    """Neither is taken in the place of the other in silence."""
    path = kept(own_folder, "cnc")
    with pytest.raises(DriveFileError, match=r"^cnc: 2 axes of the library have this name; write which: ") as problem:
        dd.read_axis("cnc")
    assert str(path) in str(problem.value)
    assert dd.read_axis(path).value("plant.mass") == 500.0
    assert dd.read_axis("gantry").name == "gantry"
    rows = [line for line in markdown().splitlines() if line.startswith("| cnc ")]
    assert len(rows) == 2
    assert str(path) in rows[1]


def test_what_is_no_drive_file_is_no_axis(working_folder, own_folder):
    own_folder.mkdir(parents=True)
    (own_folder / ".hidden.toml").write_text("", encoding="utf-8")
    (own_folder / "notes.txt").write_text("", encoding="utf-8")
    assert set(dd.axes()) == {"cnc", "emps", "gantry", "linear", "paper", "vertical"}


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[plant\n", "not a TOML file"),
        ("[plant]\nmass = 450.0\n", "damping"),
        (CNC.replace("title =", "titel ="), "titel"),
    ],
)
def test_an_unfinished_file_is_named_with_its_error_and_hides_no_other(working_folder, own_folder, text, says):
    before = markdown().splitlines()
    path = kept(own_folder, "broken", text)
    [row] = set(markdown().splitlines()) - set(before)
    assert set(before) < set(markdown().splitlines())
    assert row.startswith("| broken | cannot be read |")
    assert str(path) in row
    assert says in row
    assert set(dd.axes()) == {"cnc", "emps", "gantry", "linear", "paper", "vertical", "broken"}
    for used in (dd.axes()["broken"].read, lambda: dd.read_axis("broken"), lambda: library_axis("broken").read()):
        with pytest.raises(DriveFileError, match=says):
            used()


def test_an_axis_without_provenance_is_listed_by_its_file(working_folder, own_folder):
    head, _, rest = CNC.partition("[provenance]\n")
    path = kept(own_folder, "mill", head + "[axis]" + rest.partition("[axis]")[2])
    row = next(line for line in markdown().splitlines() if line.startswith("| mill "))
    assert row == f"| mill |  | cascade | 4 kHz | {path} |"
    assert dd.axes()["mill"].provenance == dd.Provenance()
    assert dd.axes()["mill"].text() == path.read_text(encoding="utf-8")
