"""A folder belongs to one run at a time, and says what became of it also on a full disk."""

import errno
import json
import os
import signal
import subprocess
import sys
import threading

import pytest
from typer.testing import CliRunner

from diffdrive.errors import ParameterError
from diffdrive.support.atomic_write import PREFIX
from experiments.cli.main import app
from experiments.reports.output_folder import NO_LOCKS, OutputFolder, ReservedFile
from experiments.reports.report import PAGE, RESULT, Report
from tests.support.small_disk import simulated_disk

HOLD = (
    "import sys, pathlib, experiments.reports.output_folder as o; "
    "f = o.OutputFolder(pathlib.Path(sys.argv[1]), 'result.json')"
)
WAIT = "; f.open(10); print('open', flush=True); sys.stdin.read()"
# a child as `sweep --workers` and the studies have them, which may live on for a while when its parent is killed
CHILD = "; import subprocess; c = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)']); print(c.pid)"


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def holding(folder, child=False):
    """A process that has the folder; with the id of its child."""
    program = HOLD + WAIT.replace("; sys.stdin", (CHILD if child else "; print(0)") + "; print(flush=True); sys.stdin")
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(folder)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "open\n"
    return process, int(process.stdout.readline())


def test_a_folder_that_another_run_writes_to_is_refused_and_free_again_when_that_is_killed(tmp_path):
    process, child = holding(tmp_path, child=True)
    try:
        (tmp_path / RESULT).write_text("an earlier one")
        before = names(tmp_path)
        refused = CliRunner().invoke(app, ["template", "--out", str(tmp_path)])
        assert isinstance(refused.exception, ParameterError)
        assert str(refused.exception) == (
            f"--out {tmp_path}: another run is writing to this folder; wait until it has ended, or name another"
        )
        assert names(tmp_path) == before
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()
    try:  # its child lives on, and what it left is there
        assert len(names(tmp_path)) == 3
        with Report("the next", tmp_path) as report:
            report.values("found", number=1)
    finally:
        os.kill(child, signal.SIGTERM)
    assert names(tmp_path) == [PAGE, RESULT]
    assert json.loads((tmp_path / RESULT).read_text())["found"] == {"number": 1}


def test_one_process_has_two_folders_one_below_the_other_but_none_twice(tmp_path):
    again = Report("again", tmp_path)
    with (
        Report("above", tmp_path),
        Report("below", tmp_path / "below"),
        pytest.raises(ParameterError, match="another run is writing"),
    ):
        again.__enter__()
    assert names(tmp_path) == sorted(["below", PAGE, RESULT])
    assert names(tmp_path / "below") == [PAGE, RESULT]


def test_of_many_at_once_one_has_the_folder(tmp_path):
    inside, most, served, refused = [], [], [], []

    def run():
        for _ in range(20):
            folder = OutputFolder(tmp_path, RESULT)
            try:
                folder.open(10)
            except ParameterError as problem:
                refused.append(problem)
                continue
            inside.append(1)
            most.append(len(inside))
            inside.pop()
            folder.close()
            served.append(1)

    threads = [threading.Thread(target=run) for _ in range(4)]
    for one in threads:
        one.start()
    for one in threads:
        one.join()
    assert max(most) == 1
    assert served
    assert len(served) + len(refused) == 80
    assert names(tmp_path) == []


def test_a_file_system_without_locks_is_written_to_all_the_same(tmp_path, monkeypatch):
    stale = tmp_path / f"{PREFIX}of_another_run.tmp"
    stale.write_text("")

    def unknown(*_, **__):
        raise OSError(NO_LOCKS[0], "No locks available")

    monkeypatch.setattr("filelock.FileLock.acquire", unknown)
    with Report("without", tmp_path) as report:
        report.values("found", number=1)
    assert names(tmp_path) == sorted([stale.name, PAGE, RESULT])  # it may be of a run that goes on


def test_room_that_is_held_is_there_when_the_disk_is_full(tmp_path, monkeypatch):
    result = ReservedFile(tmp_path / RESULT)
    left = simulated_disk(monkeypatch, 1000)
    result.hold(100)
    result.hold(50)
    assert left == [900]
    left[0] = 0
    assert result.write("x" * 101, "y" * 100) == 1
    assert names(tmp_path) == [RESULT]
    assert (tmp_path / RESULT).read_text() == "y" * 100
    with pytest.raises(OSError, match="No space left"):
        result.write("z")
    assert names(tmp_path) == [RESULT]
    assert (tmp_path / RESULT).read_text() == "y" * 100


@pytest.mark.parametrize("room", range(0, 30_000, 2_000))
def test_a_report_on_a_full_disk_says_so_in_its_result(tmp_path, monkeypatch, room):
    rows = [[f"row {k}", k / 7] for k in range(400)]
    out = tmp_path / "out"

    def long():
        with Report("a long one", out) as report:
            report.say("it begins")
            for k in range(4):
                report.table(f"table_{k}", ("name", "value"), rows)

    with monkeypatch.context() as full:
        simulated_disk(full, room)
        with pytest.raises(OSError, match="No space left"):
            long()
    if room == 0:
        assert not out.exists()
        return
    told = json.loads((out / RESULT).read_text())
    assert told["stopped_by"] == "OSError: [Errno 28] No space left on device"
    assert {path.name for path in out.iterdir()} <= {RESULT, *(f"table_{k}.csv" for k in range(4))}
    for path in out.glob("*.csv"):
        assert len(path.read_text().splitlines()) == 401
        assert told.get("tables", {}).get(path.stem, {}).get("rows", rows) == rows


def test_a_lock_that_belongs_to_another_user_is_refused_in_one_line(tmp_path, monkeypatch):
    def closed(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("filelock.FileLock.acquire", closed)
    report = Report("refused", tmp_path)
    with pytest.raises(ParameterError, match=r"--out .*: cannot be written to \(Permission denied\)"):
        report.__enter__()
    assert names(tmp_path) == []
