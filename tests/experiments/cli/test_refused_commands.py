"""What no command takes, said in one line before anything is computed: options, folders, numbers."""

import inspect
import os
from typing import get_args, get_type_hints

import pytest
from typer.testing import CliRunner

from diffdrive.errors import ParameterError
from experiments.cli.main import app
from tests.support.command_line import SHORT, refused, run

REFUSED = {
    "a motion beyond the stroke": (
        "simulate",
        ("--motion", SHORT.replace("stroke=2mm", "stroke=2m,start=1")),
        "stroke",
    ),
    "a motion that settles for ever": ("simulate", ("--motion", SHORT, "--settle", 5), "settle: 5 s leaves nothing"),
    "a shape of load that there is not": (
        "simulate",
        ("--motion", SHORT, "--load", "stepp:to=3"),
        "load: no shape 'stepp'; known: constant, step, ramp, piecewise, material_removal",
    ),
    "a motion that there is not": ("simulate", ("--motion", "zigzag:speed=1"), "motion: 'zigzag:speed=1' is neither"),
    "an aggregation that there is not": (
        "tune",
        ("--aggregation", "avg"),
        "--aggregation: no aggregation 'avg'; known: mean, worst, cvar",
    ),
    "a load that lifts": ("tune", ("--max-load", "-3kN"), "--max-load -3kN: must be 0 or more"),
    "noise below none": ("tune", ("--pareto", "5;-3 N"), "--pareto 5;-3 N: each limit must be above 0"),
    "speeds without a unit": ("convergence", ("--speeds", "10;20"), "--speeds 10;20: give the unit behind the last"),
    "a first speed without a unit": ("convergence", ("--speeds", "10 mm/s;20"), "give the unit behind the last"),
    "no speed": ("convergence", ("--speeds", " ; "), "--speeds is empty"),
    "speeds in kg": ("convergence", ("--speeds", "10;20 kg"), "--speeds: '10 kg' has the wrong unit"),
}


@pytest.mark.parametrize(("command", "options", "says"), REFUSED.values(), ids=REFUSED.keys())
def test_a_command_that_is_refused_leaves_its_folder_as_it_was(drive_file, tmp_path, command, options, says):
    good = tmp_path / "good"
    good.mkdir()
    (good / "result.json").write_text("an earlier one")
    assert says in refused(command, drive_file, *options, "--out", good)
    assert {path.name: path.read_text() for path in good.iterdir()} == {"result.json": "an earlier one"}
    refused(command, drive_file, *options, "--out", tmp_path / "new" / "below")
    assert not (tmp_path / "new").exists()


def test_a_log_that_cannot_be_read_leaves_the_folder_as_it_was(drive_file, tmp_path):
    (tmp_path / "nolog.csv").write_text("a,b\n1,2\n")
    assert "nolog.csv" in refused("identify", tmp_path / "nolog.csv", "--drive", drive_file, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_misspelt_effect_is_answered_with_the_one_that_was_meant(drive_file):
    said = refused("diagnose", "lap.csv", "--drive", drive_file, "--without", "coging")
    assert "--without: no effect 'coging'; did you mean 'cogging'?" in said


@pytest.mark.parametrize("command", ["simulate", "tune", "convergence", "sweep", "template"])
def test_a_folder_that_cannot_be_written_to_is_named_before_anything_is_computed(drive_file, command, monkeypatch):
    computed = []
    for name in (
        "experiments.reports.simulation.simulate", "experiments.reports.tuning.tune",
        "experiments.reports.simulation.convergence_gains", "tuning.sweeps.workflow.run_parts",
    ):  # fmt: skip
        monkeypatch.setattr(name, lambda *_, **__: computed.append(command))
    below = drive_file / "x"
    options = () if command == "template" else (drive_file,)
    assert f"--out {below}: cannot be written to" in refused(command, *options, "--out", below)
    assert f"--out {drive_file}: is a file" in refused(command, *options, "--out", drive_file)
    assert not computed


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="permissions that bind")
def test_a_folder_that_may_not_be_looked_into_is_named(drive_file, tmp_path):
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o000)
    assert "cannot be written to" in refused("template", "--out", closed)
    assert "cannot be written to" in refused("template", "--out", closed / "below")


def test_a_folder_needs_a_name_and_a_link_needs_its_folder(drive_file, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for empty in ("", " "):
        answer = run("simulate", drive_file, "--out", empty)
        assert answer.exit_code == 2
        assert "is empty; name a folder" in answer.output + answer.stderr
    (tmp_path / "link").symlink_to(tmp_path / "nowhere")
    assert "--out link: is a link to a folder that is not there" in refused("template", "--out", "link")
    assert {path.name for path in tmp_path.iterdir()} == {"drive.toml", "link"}


NUMBERS = {float: ["nan", "inf", "-inf", "1e400"], int: ["9" * 400, "-" + "9" * 400, str(10**22)]}


def numeric_options():
    """Every option of every command that takes a number, with what no number may be."""
    groups = [app, *(group.typer_instance for group in app.registered_groups)]
    found = []
    for command in (one for group in groups for one in group.registered_commands):
        hints = get_type_hints(command.callback)
        needed = [
            ("--" + key if get_args(hints[key]) == () and key == "out" else None)
            for key, one in inspect.signature(command.callback).parameters.items()
            if one.default is inspect.Parameter.empty
        ]
        files = [text for option in needed for text in ([option, "x"] if option else ["x"])]
        for key, hint in hints.items():
            kinds = set(NUMBERS) & {hint, *get_args(hint)}
            name = command.name or command.callback.__name__
            found += [(name, files, f"--{key.replace('_', '-')}", value) for kind in kinds for value in NUMBERS[kind]]
    return found


@pytest.mark.parametrize(
    ("command", "files", "option", "value"),
    [pytest.param(*one, id=f"{one[0]} {one[2]} {one[3][:12]}") for one in numeric_options()],
)
def test_no_numeric_option_takes_what_no_number_is(command, files, option, value, tmp_path, monkeypatch):
    """Not a number, infinite, or of more digits than the libraries count with: refused before a file is looked for."""
    monkeypatch.chdir(tmp_path)
    answer = CliRunner().invoke(app, [command, *files, f"{option}={value}"])
    said = f"{answer.exception} {answer.output}"
    assert isinstance(answer.exception, ParameterError) or answer.exit_code == 2
    assert option in said
