"""Every file is complete or absent, whatever ends its write; and there is no other way to write one."""

import ast
import json
import os
import threading
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

import diffdrive
from diffdrive.axis_file.drive_file import write_axis
from diffdrive.errors import LogError
from diffdrive.logs import write_log
from diffdrive.support.atomic_write import (
    NO_SPACE,
    PREFIX,
    atomic_write,
    remove_temporary,
    temporary_beside,
    write_text,
)
from experiments.reports.report import Report
from experiments.reports.theme import new_figure
from tests.support.small_disk import simulated_disk
from tests.support.sound_log import DRIVE, SOUND
from tuning.gains.checkpoint import CHECKPOINT, Checkpoint
from tuning.gains.sequential import SearchState
from tuning.sweeps.parts import write_part

CODE = Path(diffdrive.__file__).parents[1]
TEXT = "as it was\n"


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def test_two_that_write_one_file_lose_nothing(tmp_path):
    path, problems = tmp_path / "result.json", []

    def writing(number):
        for k in range(100):
            try:
                write_text(path, json.dumps({"by": number, "data": [k] * 500}))
                json.loads(path.read_text())
            except (OSError, ValueError) as problem:
                problems.append(problem)

    both = [threading.Thread(target=writing, args=(number,)) for number in range(2)]
    for one in both:
        one.start()
    for one in both:
        one.join()
    assert not problems
    assert names(tmp_path) == ["result.json"]


@pytest.mark.parametrize("stopped_by", [ValueError, KeyboardInterrupt, OSError])
def test_a_write_that_is_stopped_leaves_the_file_as_it_was(tmp_path, stopped_by):
    path = tmp_path / "drive.toml"
    path.write_text(TEXT)

    def stopped():
        with atomic_write(path, "w") as file:
            file.write("half")
            raise stopped_by

    with pytest.raises(stopped_by):
        stopped()
    assert path.read_text() == TEXT
    assert names(tmp_path) == ["drive.toml"]


def test_a_link_stays_a_link_and_permissions_are_those_of_any_new_file(tmp_path):
    there, link, plain = tmp_path / "there" / "drive.toml", tmp_path / "drive.toml", tmp_path / "plain"
    there.parent.mkdir()
    there.write_text(TEXT)
    plain.write_text(TEXT)
    try:
        link.symlink_to(there)
    except OSError as problem:
        pytest.skip(f"no links here: {problem}")
    write_text(link, "new")
    assert link.is_symlink()
    assert there.read_text() == "new"
    assert there.stat().st_mode == plain.stat().st_mode


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such permissions")
def test_what_is_private_is_so_before_anything_is_in_it(tmp_path):
    path = tmp_path / "key"
    path.write_text("old")
    with atomic_write(path, "w", private=True) as file:
        [temporary] = (one for one in tmp_path.iterdir() if one != path)
        assert temporary.stat().st_mode & 0o777 == 0o600
        file.write("new")
    assert (path.read_text(), path.stat().st_mode & 0o777) == ("new", 0o600)


def test_what_a_killed_process_left_goes_and_nothing_else(tmp_path):
    for name in (temporary_beside(tmp_path / "run.csv").name, f"{PREFIX}4567.tmp", "run.csv", ".hidden"):
        (tmp_path / name).write_text("")
    assert [path.name for path in tmp_path.glob("*.csv")] == ["run.csv"]  # pathlib's pattern takes hidden files, too
    remove_temporary(tmp_path)
    assert names(tmp_path) == [".hidden", "run.csv"]
    remove_temporary(tmp_path / "absent")


def figure(path):
    drawn, axes = new_figure()
    axes.plot(np.arange(100.0))
    report = Report("figure", path.parent)
    report.figure(path.stem, drawn)


def table(path):
    Report("table", path.parent).table(path.stem, ("name", "value"), [["x" * 80, k / 7] for k in range(200)])


def checkpoint(path):
    Checkpoint(path.parent, "problem").save(0, SearchState(theta=tuple(np.arange(500.0))))


WRITERS = {
    "log.csv": lambda path: write_log(path, SOUND),
    "log.parquet": lambda path: write_log(path, SOUND),
    "log.mat": lambda path: write_log(path, SOUND),
    "log.73.mat": lambda path: write_log(path, SOUND),
    "drive.toml": lambda path: write_axis(path, DRIVE),
    "table.csv": table,
    "figure.png": figure,
    "part-000000.parquet": lambda path: write_part(
        pa.table({"rms_m": np.random.default_rng(0).random(4000)}), path, "?"
    ),
    CHECKPOINT: checkpoint,
}


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("share", [0.0, 0.5, 0.999])
def test_a_full_disk_leaves_the_file_as_it_was(name, share, tmp_path, monkeypatch):
    path, write = tmp_path / name, WRITERS[name]
    write(path)
    size = path.stat().st_size
    before = path.read_bytes()
    with monkeypatch.context() as full:
        simulated_disk(full, int(share * size))
        with pytest.raises((OSError, LogError), match="No space left on device") as problem:
            write(path)
    assert isinstance(problem.value, LogError) or problem.value.errno in NO_SPACE
    assert path.read_bytes() == before
    assert names(tmp_path) == [name]
    write(path)  # and is there again when there is room


ALONE = {  # that write otherwise: the helpers, what runs before anything is installed, and files of a passing folder
    "diffdrive/support/atomic_write.py", "experiments/reports/output_folder.py", "experiments/bootstrap.py",
    "experiments/studies/withheld/study.py:write_text",
    "experiments/app/workspace.py:open",  # an upload, which two tabs may send under one name
    "experiments/app/command.py:open",  # what a run prints, as it prints it
}  # fmt: skip
METHODS = ("write_text", "write_bytes")  # of a Path
LIBRARIES = ("savefig", "savemat", "savetxt", "save", "savez", "savez_compressed", "write_table", "to_netcdf", "to_csv",
             "to_parquet", "dump", "ParquetWriter", "File")  # fmt: skip


def _writes(node):
    """The name of a call that writes a file in another way, or None."""
    if not isinstance(node, ast.Call):
        return None
    method = isinstance(node.func, ast.Attribute)
    name = node.func.attr if method else getattr(node.func, "id", "")
    if name == "open":
        said = [one.value for one in (*node.args, *(k.value for k in node.keywords)) if isinstance(one, ast.Constant)]
        return name if any(isinstance(one, str) and set(one) & set("wax+") and len(one) < 4 for one in said) else None
    if method and name in METHODS:
        return name
    if method and name in LIBRARIES:
        places = [one.id for one in node.args if isinstance(one, ast.Name)]
        in_memory = name == "to_netcdf" and not node.args
        # a result's own `save` goes by the helper
        in_memory |= name == "save" and getattr(node.func.value, "id", "") not in ("np", "numpy", "jnp")
        reads = name == "File" and any(isinstance(one, ast.Constant) and one.value == "r" for one in node.args)
        return None if in_memory or reads or set(places) & {"file", "written", "buffer"} else name
    return None


def test_every_file_is_written_by_the_one_helper():
    found = set()
    for path in (one for package in ("diffdrive", "tuning", "experiments") for one in (CODE / package).rglob("*.py")):
        name = path.relative_to(CODE).as_posix()
        calls = {call for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if (call := _writes(node))}
        found |= {f"{name}:{call}" for call in calls if name not in ALONE}
    assert found - ALONE == set()
