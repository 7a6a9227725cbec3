"""The command line as a user meets it."""

import errno
import json
import os
import re
import signal
import subprocess
import sys
import tomllib
import warnings
from importlib import metadata

import numpy as np
import platformdirs
import pytest
from typer.testing import CliRunner

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.controllers import KINDS
from diffdrive.errors import LoadEstimatorWarning, ParameterError
from diffdrive.logs import ColumnMapping, read_log
from diffdrive.logs.formats.registry import EXTENSIONS
from diffdrive.motion.text import numbers as numbers_of
from diffdrive.paper import paper_axis
from experiments.cli import main as cli
from experiments.cli import texts
from experiments.cli.main import app
from experiments.reports.report import Report
from tests.support.command_line import SHORT, refused, run


def numbers(folder):
    return json.loads((folder / "result.json").read_text())


def test_help_names_every_command():
    shown = run("--help").output
    commands = (
        "demo simulate margins start check identify compare diagnose tune sweep replay convergence reproduce bench "
        "template keys"
    )
    for command in commands.split():
        assert command in shown
        assert run(command, "--help").exit_code == 0


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("0.5", [0.5]),
        ("0;1.5", [0.0, 1.5]),
        ("0;1e-3", [0.0, 1e-3]),
        ("5;10.5 ms", [5e-3, 10.5e-3]),
        ("5 ms;1.5", [5e-3, 1.5]),
        ("1;.5s", [1.0, 0.5]),
    ],
)
def test_a_list_of_numbers_has_the_unit_behind_its_last_one(text, found):
    assert numbers_of(text, "s", "times") == pytest.approx(found)


def test_the_version_is_that_of_the_package():
    assert run("--version").output == f"diffdrive {metadata.version('diffdrive')}\n"


@pytest.mark.parametrize(
    ("command", "option", "known"),
    [
        ("bench", "part", re.compile("known: (.*)")),
        ("simulate", "motion", re.compile("motions (.*)")),
        ("simulate", "load", re.compile("known: (.*)")),
        ("sweep", "method", re.compile("known: (.*)")),
        ("tune", "aggregation", re.compile("known: (.*)")),
    ],
)
def test_the_help_of_an_option_names_all_that_it_takes(drive_file, tmp_path, command, option, known):
    files = () if command == "bench" else (drive_file,)
    told = refused(command, *files, f"--{option}", "foo:bar=1")
    shown = run(command, "--help").output
    for name in known.search(told)[1].split(", "):
        assert name == "constant" or re.search(rf"\b{name}\b", shown), name  # a bare number is a constant load


def test_the_help_of_logs_names_every_format():
    shown = run("check", "--help").output.casefold()
    assert [name for name in EXTENSIONS if name not in shown] == []


def test_the_keys_are_all_that_a_drive_file_may_hold(drive_file):
    shown = run("keys").output
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in shown.splitlines()]
    known = {(row[0], row[2]) for row in rows}
    for table, values in tomllib.loads(drive_file.read_text()).items():
        for key, value in values.items():
            if isinstance(value, dict):
                assert {(f"[{table}.{key}]", below) for below in value} <= known
            elif table not in ("columns", "units") or key.startswith("force_per"):
                assert (f"[{table}]", key) in known
    assert {("[sampling]", "substeps"), ("[controller]", "velocity_samples"), ("[actuator]", "delay_samples")} <= known


def test_texts_that_are_kept_follow_their_sources(tmp_path, monkeypatch):
    monkeypatch.setattr(platformdirs, "user_cache_dir", lambda *_, **__: str(tmp_path / "cache"))
    package, made = tmp_path / "package", []
    package.mkdir()
    (package / "__init__.py").write_text("")
    monkeypatch.setattr(texts.diffdrive, "__file__", str(package / "__init__.py"))
    catalogues = texts.CATALOGUES
    monkeypatch.setattr(texts, "CATALOGUES", ())

    def make():
        made.append(1)
        return f"made {len(made)} times"

    assert [texts.cached(make, "a.md") for _ in range(2)] == ["made 1 times"] * 2
    (package / "effects.py").write_text("one more")
    assert texts.cached(make, "a.md") == "made 2 times"
    monkeypatch.setattr(texts, "CATALOGUES", catalogues)  # which are loaded here: a program may have registered more
    assert [texts.cached(make, "a.md") for _ in range(2)] == ["made 3 times", "made 4 times"]


@pytest.mark.parametrize("arguments", [["--help"], ["tune", "--help"], ["template"]])
def test_what_computes_nothing_does_not_wait_for_jax(arguments):
    program = (
        f"import sys; from experiments.cli.main import app; "
        f"app({arguments}, standalone_mode=False); sys.exit('jax' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_template_is_a_drive_file(drive_file):
    assert float(read_axis(drive_file).drive.plant.mass) == 100.0


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


def test_a_warning_of_eq_20_names_the_kind_that_mends_it(drive_file):
    with pytest.warns(LoadEstimatorWarning, match=r'does not converge at .*15 mm/s.*kind = "pd\+fc\+ls"'):
        run("simulate", drive_file, "--motion", SHORT.replace("10mm/s", "15mm/s"))


def test_an_expected_error_is_one_line_and_code_2(drive_file):
    drive_file.write_text(drive_file.read_text().replace("mass = 100.0", 'mass = "100 mm"'))
    command = [sys.executable, "-c", "from experiments.cli.main import main; main()", "simulate", str(drive_file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stdout == ""
    assert "error: " in done.stderr
    assert "[plant] mass" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(os.name == "nt", reason="a POSIX signal")
def test_whoever_is_ended_loses_no_more_than_by_an_interrupt(tmp_path):
    ended = (
        "import os, signal, sys; from diffdrive.axis_file import reference as keys; "
        "from experiments.cli import main as cli; "
        "sys.argv = ['diffdrive', 'keys']; keys.markdown = lambda: os.kill(os.getpid(), signal.SIGTERM); cli.main()"
    )
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}  # in which no table of keys is kept
    run = subprocess.run([sys.executable, "-c", ended], env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 130
    assert "what was written so far stays" in run.stderr


def test_a_full_disk_ends_in_one_line_and_leaves_the_last_result_whole(monkeypatch, capsys, tmp_path):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(cli, "app", full)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 2
    assert "no room is left on the disk" in capsys.readouterr().err
    with Report("first", tmp_path) as report:
        report.values("kept", number=1)
    before = (tmp_path / "result.json").read_bytes()
    monkeypatch.setattr("pathlib.Path.replace", full)
    with pytest.raises(OSError, match="No space"), Report("second", tmp_path) as report:
        report.values("lost", number=2)
    assert (tmp_path / "result.json").read_bytes() == before


def test_what_was_found_before_an_error_is_kept_and_said_to_be_a_part(tmp_path, capsys):
    def work():
        with Report("title", tmp_path) as report:
            report.values("first", done=1)
            raise ValueError("late")

    with pytest.raises(ValueError, match="late"):
        work()
    assert numbers(tmp_path)["stopped_by"] == "ValueError: late"
    printed = capsys.readouterr().out
    assert "stopped; what was found by then is in" in printed
    assert "written to" not in printed


def test_a_table_prints_the_names_of_a_files_tables(capsys):
    """Square brackets are no markup."""
    with Report("title", None) as report:
        report.table("findings", ["mend"], [["where [units] says so"]])
    assert "where [units] says so" in capsys.readouterr().out


@pytest.mark.filterwarnings("ignore::diffdrive.errors.LoadEstimatorWarning")
def test_a_run_is_the_motion_that_it_was_asked_for_and_not_the_one_that_was_measured(drive_file, tmp_path):
    first = run("simulate", drive_file, "--motion", SHORT, "--out", tmp_path / "first")
    again = run("simulate", drive_file, "--motion", tmp_path / "first" / "run.csv", "--out", tmp_path / "again")
    assert first.exit_code == again.exit_code == 0
    assert "run.csv (column reference)" in again.output
    ours, theirs = (
        read_log(tmp_path / name / "run.csv", mapping=ColumnMapping(units={"command": "N"}))
        for name in ("first", "again")
    )
    np.testing.assert_array_equal(ours.reference, theirs.reference)
    assert not np.array_equal(ours.reference, ours.position)


HOSTILE = "[red]:on: \x1b[31mfire\x1b[0m\x07 [/bold]"
SHOWN = r"[red]:on: \x1b[31mfire\x1b[0m\x07 [/bold]"


def test_what_a_file_says_is_printed_as_it_is_and_never_obeyed(capsys):
    """Neither markup nor emoji nor the codes of a terminal, wherever a name of a file or a key comes to be printed."""
    with Report(HOSTILE, None) as report:
        report.say(HOSTILE)
        report.values(HOSTILE, **{HOSTILE: HOSTILE})
        report.table(HOSTILE, [HOSTILE], [[HOSTILE]])
        with report.working(HOSTILE), report.stages() as stages, report.counted(HOSTILE, 1) as done:
            stages(HOSTILE, 1, 1)
            done(1)
    printed = capsys.readouterr().out.replace("\n", "")
    assert "\x1b" not in printed
    assert "\x07" not in printed
    assert printed.count(SHOWN) >= 7


def test_errors_and_warnings_show_the_codes_that_they_quote(monkeypatch, capsys):
    def failing():
        warnings.warn(HOSTILE, LoadEstimatorWarning, stacklevel=1)
        raise ParameterError(HOSTILE)

    monkeypatch.setattr(cli, "app", failing)
    monkeypatch.setattr(signal, "signal", lambda *_: None)
    monkeypatch.setattr(warnings, "showwarning", warnings.showwarning)
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with pytest.raises(SystemExit):
            cli.main()
    assert capsys.readouterr().err == f"warning: {SHOWN}\nerror: {SHOWN}\n"


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "unknown"])
def test_the_template_states_any_controller(kind, tmp_path):
    path = tmp_path / "drive.toml"
    path.write_text(CliRunner().invoke(app, ["template", "--controller", kind]).output, encoding="utf-8")
    axis, paper = read_axis(path), paper_axis(controller=kind)
    assert axis.controller.kind == kind
    assert axis.gains == pytest.approx(paper.gains, rel=1e-6)
    assert axis.parameters == paper.parameters
    assert axis.mapping.force_per_volt == pytest.approx(paper.mapping.force_per_volt, rel=1e-5)


def test_the_template_is_of_a_controller_that_follows_any_load():
    assert 'kind = "pd+fc+ls"' in CliRunner().invoke(app, ["template"]).output
    assert "no kind 'pid'" in refused("template", "--controller", "pid")
