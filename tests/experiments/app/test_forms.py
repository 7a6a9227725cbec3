"""What comes of a form is a command line that the commands take; what was stated for a trace goes along."""

import shlex
from xml.etree import ElementTree

import pytest
import typer

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.library.search import FOLDERS
from diffdrive.logs.log import READABLE
from experiments.app import mapping
from experiments.app.console import parse_console
from experiments.app.drive_files import drive_file, drive_files
from experiments.app.forms import BY_COMMAND, FORMS, arguments, follow_up
from experiments.app.look import curve
from experiments.app.preview import drawings
from experiments.app.workspace import AppError, Workspace
from experiments.cli.main import app


@pytest.fixture
def workspace(tmp_path):
    workspace = Workspace(tmp_path / "work")
    for name in ("before.csv", "after.csv", "drive.toml"):
        workspace.add(name, b"time,position,command\n")
    return workspace


def line_of(workspace, command, **values):
    stated = lambda path: mapping.stated(workspace, path)  # noqa: E731
    return arguments(BY_COMMAND[command], values, workspace.path, stated)


@pytest.mark.parametrize("form", FORMS, ids=lambda form: form.command)
def test_every_option_of_a_form_is_one_of_its_command(form):
    command = typer.main.get_command(app).commands[form.command]
    known = {option for parameter in command.params for option in parameter.opts}
    asked = {field.option for field in (*form.fields, *form.more) if field.option}
    assert asked | {"--out"} <= known
    assert not form.mapped or {"--column", "--unit"} <= known


def test_a_diagnosis_with_stated_columns(workspace):
    mapping.keep(workspace, "before.csv", {"position": "Act Pos", "command": "M=soll"}, {"command": "-0.1 %"})
    line = line_of(workspace, "diagnose", traces=["files/before.csv"], drive="files/drive.toml", tune=True, load="8kN")
    assert shlex.join(line) == (
        "--drive=files/drive.toml --tune --load=8kN '--column=position=Act Pos' --column=command=M=soll "
        "'--unit=command=-0.1 %' files/before.csv"
    )


def test_a_comparison_keeps_both_sides_apart(workspace):
    traces = {"before": ["files/before.csv"], "after": ["files/after.csv"]}
    line = line_of(workspace, "compare", drive="files/drive.toml", **traces)
    assert line == ["--drive=files/drive.toml", "files/before.csv", "--", "files/after.csv"]


def test_traces_with_other_columns_do_not_go_together(workspace):
    mapping.keep(workspace, "before.csv", {"position": "p", "command": "c"}, {})
    traces = ["files/before.csv", "files/after.csv"]
    with pytest.raises(AppError, match=r"after\.csv: has other columns"):
        line_of(workspace, "check", traces=traces, drive="files/drive.toml")


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({}, "Traces of one machine: choose one or more"),
        ({"traces": ["files/before.csv"]}, "Drive file: choose one"),
        ({"traces": ["files/before.csv"], "drive": "/etc/passwd"}, "there is no file"),
        ({"traces": ["files/gone.csv"], "drive": "files/drive.toml"}, "choose another"),
        ({"traces": ["files/before.csv"], "drive": "files/drive.toml", "load": "1\n2"}, "Load on the guides"),
    ],
)
def test_a_form_that_is_not_complete_is_refused_by_the_name_of_its_field(workspace, values, says):
    with pytest.raises(AppError, match=says):
        line_of(workspace, "check", **values)


def test_the_next_question_begins_with_the_traces_and_the_drive_file_of_this_one():
    start = ["start", "--out", "jobs/1/out", "--drive", "jobs/1/out/drive.toml", "--mass=9kg", "files/a.csv"]
    assert follow_up(start) == {"traces": ["files/a.csv"], "drive": "jobs/1/out/drive.toml"}
    identify = ["identify", "--out", "jobs/2/out", "--drive=files/drive.toml", "files/a.csv", "files/b.csv"]
    assert follow_up(identify) == {"traces": ["files/a.csv", "files/b.csv"], "drive": "files/drive.toml"}
    assert follow_up(identify, "jobs/2/out/identified.toml")["drive"] == "jobs/2/out/identified.toml"


def test_the_channels_are_those_that_a_log_may_hold():
    assert sorted(mapping.CHANNELS) == sorted(READABLE)
    assert {name for name in READABLE if READABLE[name].required} - {"time"} == set(mapping.NEEDED)


@pytest.mark.parametrize(
    ("columns", "units", "says"),
    [
        ({"position": "a", "command": "a"}, {}, "is position already|is command already"),
        ({"position": "a"}, {}, "command: choose the column"),
        ({"position": "a", "command": "b"}, {"load": "N"}, "load: has a unit and no column"),
        ({"position": "a", "command": "b"}, {"command": "N" * 100}, "is no unit"),
    ],
)
def test_columns_that_cannot_be_are_refused_by_their_channel(workspace, columns, units, says):
    with pytest.raises(AppError, match=says):
        mapping.keep(workspace, "before.csv", columns, units)
    assert mapping.stated(workspace, "files/before.csv") == {}


def test_a_form_of_columns_begins_with_what_was_stated_else_with_the_guess(workspace):
    look = {"chosen": {"position": "x", "command": "u"}, "units": {"position": "mm"}}
    assert mapping.first_choice({}, look)["position"] == ("x", "mm")
    mapping.keep(workspace, "before.csv", {"position": "y", "command": "u"}, {})
    kept = mapping.stated(workspace, "files/before.csv")
    assert mapping.first_choice(kept, look)["position"] == ("y", "")


def test_a_peak_of_one_sample_is_seen_in_a_long_curve():
    import numpy as np

    values = np.zeros(1_000_003)
    values[654_321], values[-1] = 5.0, -2.0
    points = curve(values)
    assert (max(high for _, high in points), min(low for low, _ in points)) == (5.0, -2.0)


def test_every_drive_file_to_begin_with_is_one(tmp_path):
    assert {"drive", "paper", "gantry"} <= set(drive_files())
    for name in drive_files():
        path = tmp_path / f"{name}.toml"
        path.write_bytes(drive_file(name))
        read_axis(path)
    with pytest.raises(AppError, match="no axis"):
        drive_file("../secret")


def test_an_unfinished_file_of_the_user_hides_no_other(tmp_path, monkeypatch):
    (tmp_path / "broken.toml").write_text("[plant\n")
    (tmp_path / "notepad.toml").write_text('[provenance]\ntitle = "größer"\n', encoding="utf-8-sig")
    monkeypatch.setenv(FOLDERS, str(tmp_path))
    listed = drive_files()
    assert {"drive", "paper", "gantry"} < set(listed)
    assert "cannot be read" in listed["broken"]
    assert listed["notepad"] == "größer"


def test_a_drawing_quotes_the_names_of_columns():
    name = "<script>alert(1)</script>\" onload='x'"
    figure = ElementTree.fromstring(drawings([(name, [[0.0, 1.0], [1.0, 2.0]])]))
    assert {one.tag for one in figure.iter()} == {"figure", "figcaption", "svg", "polygon"}
    assert figure[0].text == f"{name}: 0 to 2" == figure[1].get("aria-label")
    assert "onload" not in figure[1].attrib


LOG = """$ diffdrive diagnose first
searching: 1 of 2, 3 s
$ diffdrive diagnose second
recalibrating: 0 of 1, 1 s
recalibrating: 1 of 1, 14 s
fitting: 0 of 10, 53 s
fitting: 6 of 6, 77 s
So far, search: cogging.
screening: 0 of 2, 78 s
fitting: 0 of 2, 80 s
Traceback (most recent call last):
  File "x.py", line 1
"""


def test_a_log_is_that_of_the_last_run_without_its_traceback():
    found = parse_console(LOG)
    assert [(stage.name, stage.share) for stage in found.stages] == [
        ("recalibrating", 1.0), ("screening", 1.0), ("fitting", 0.0),
    ]  # fmt: skip
    assert found.failed
    assert "Traceback" not in found.text
    assert "first" not in found.text


def test_the_box_of_a_misspelt_option_is_its_sentence():
    box = "Usage: ...\n╭─ Error ──╮\n│ Invalid value for '--starts': 'x' │\n│ is not a number.       │\n╰──╯\n"
    assert parse_console(box).error == "Invalid value for '--starts': 'x' is not a number."
