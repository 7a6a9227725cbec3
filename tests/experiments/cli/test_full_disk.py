"""What a command leaves on a disk that fills up while it writes: whole files, and why it stopped."""

import csv
import io
import json
import signal
import sys
import tomllib

import h5py
import numpy as np
import pyarrow.parquet as pq
import pytest

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.library import PAPER_DRIVE
from diffdrive.logs import write_log
from experiments.cli import main as cli
from experiments.studies.emps import axis as emps
from tests.support.small_disk import PAGE, mounted_disk
from tests.support.sound_log import DRIVE, SOUND
from tuning.store.folder import FolderStore

MOTION = "sine:amplitude=1mm,frequency=10Hz,duration=0.3s"
SWEEP = ("sweep", PAPER_DRIVE, "--motion", MOTION, "--samples", 8, "--settle", 0.1, "--vary", "plant.mass=normal:3%")
# where the disk is full, of all that the command writes
SHARES = (0.3, 0.6, 0.95)

LIGHT = {
    "template": ("template",),
    "keys": ("keys",),
    "motions": ("motions",),
    "simulate": ("simulate", PAPER_DRIVE, "--motion", MOTION),
    "check": ("check", "lap.csv", "--drive", "drive.toml"),
    "sweep": (*SWEEP, "--record", "error"),
    "replay": ("replay", "swept", "--machine", 1),
}
HEAVY = {
    "convergence": ("convergence", PAPER_DRIVE),
    "tune": ("tune", PAPER_DRIVE, "--starts", 1, "--steps", 2, "--loads", 2, "--machines", 1, "--command-noise", "1kN"),
    "identify": ("identify", "lap.csv", "--drive", "drive.toml", "--starts", 1),
    "diagnose": ("diagnose", "lap.csv", "--drive", "drive.toml", "--most-effects", 1),
    "demo": ("demo", "--quick"),
    "reproduce": ("reproduce",),
    "recovery": ("recovery", "--draws", 1, "--workers", 1),
    "bench": ("bench", "--part", "start"),
    "log-study": ("log-study", "--cases", 4, "--sound", 4, "--pairs", 3),
    "tuning-study": ("tuning-study", "--evaluations", 50, "--runs", 1, "--starts", 1),
    "withheld": ("withheld", "--cases", 1),
    "emps": ("emps",),
    "evolution": ("evolution", "--seconds", 5, "--runs", 1),
}
CONTINUED = ("withheld",)
MEASURED = ("emps", "evolution")  # which need the benchmark's files


@pytest.fixture
def ended(monkeypatch, capsys):
    """A command as on the command line: its code, and what it says of the error."""

    def run(*arguments):
        monkeypatch.setattr(signal, "signal", lambda *_: None)
        monkeypatch.setattr(sys, "argv", ["diffdrive", *map(str, arguments)])
        capsys.readouterr()
        with pytest.raises(SystemExit) as end:
            cli.main()
        return end.value.code, capsys.readouterr().err

    return run


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """A folder with a drive file and a log."""
    folder = tmp_path_factory.mktemp("given")
    write_axis(folder / "drive.toml", DRIVE)
    write_log(folder / "lap.csv", SOUND)
    return folder


def assert_whole(path):
    """Whether nothing of a file is missing, as its format can tell."""
    data = path.read_bytes()
    if path.suffix == ".csv":
        rows = list(csv.reader(data.decode().splitlines()))
        assert len(rows) > 1
        assert len({len(row) for row in rows}) == 1
        assert data.endswith(b"\n")
    elif path.suffix == ".json":
        json.loads(data)
    elif path.suffix == ".jsonl":
        assert all(json.loads(line) for line in data.decode().splitlines())
    elif path.suffix == ".toml":
        assert tomllib.loads(data.decode())
    elif path.suffix == ".png":
        assert data[-8:-4] == b"IEND"
    elif path.suffix == ".html":
        assert data.endswith(b"</html>")
    elif path.suffix == ".parquet":
        assert pq.read_table(path).num_rows
    elif path.suffix == ".npz":
        assert dict(np.load(io.BytesIO(data), allow_pickle=False))
    elif path.suffix == ".nc":
        with h5py.File(path) as file:
            assert "error" in file
    else:
        assert path.suffix == ".md"
        assert data.endswith(b"|\n")


def filled_up(ended, out, arguments, room):
    """Run a command on a disk of so many bytes, and see what it leaves; how many files that are."""
    with mounted_disk(out, max(1, int(room) // PAGE)):
        code, says = ended(*arguments, "--out", out)
        [error] = [line for line in says.splitlines() if "warning" not in line]
        assert code == 2
        assert error.startswith("error: ")
        assert "no room is left on the disk" in error or "No space left on device" in error
        files = [path for path in out.rglob("*") if path.is_file()]
        assert not [path for path in files if path.name.startswith(".")]
        for path in files:
            assert_whole(path)
        for path in files:
            if path.name == "result.json":
                assert "No space left on device" in json.loads(path.read_text())["stopped_by"]
        # finished parts, from which the same command continues, and which a finished one removes
        return {path.name for path in files if not any(is_part(one) for one in path.relative_to(out).parts[:-1])}


# files from which the same command continues
CONTINUED_FROM = {"tuning.checkpoint.json", "key.json"}


def is_part(folder):
    """Whether a folder of that name holds what the same command continues from."""
    return folder.endswith(".parts") or folder in ("cases", "answers", "key_parts")


def taken(folder):
    """The bytes that its files take on a disk."""
    return sum(-(-path.stat().st_size // PAGE) * PAGE for path in folder.rglob("*") if path.is_file())


def on_small_disks(ended, tmp_path, arguments, shares, monkeypatch):
    """What it leaves on disks of these shares of what it writes, room for its finished parts apart."""
    everything = tmp_path / "everything"
    with monkeypatch.context() as patch:
        patch.setattr(FolderStore, "remove", lambda _: None)
        code, says = ended(*arguments, "--out", everything)
    assert code in (0, 3, None), says
    parts = sum(taken(folder) for folder in everything.glob("*.parts"))
    files = {path.name for path in everything.rglob("*") if path.is_file()}
    if parts:  # it stops early, and leaves little but those to continue from
        assert filled_up(ended, tmp_path / "small", arguments, 0.6 * parts) <= {"result.json"}
    room = taken(everything) - parts
    left = [filled_up(ended, tmp_path / "small", arguments, parts + share * room) for share in shares]
    # all where only a file that is written twice found no room
    assert all(one - CONTINUED_FROM <= files for one in left)
    return left


@pytest.mark.long
@pytest.mark.parametrize("name", LIGHT)
def test_a_command_on_a_full_disk_leaves_whole_files(name, given, ended, tmp_path, monkeypatch):
    monkeypatch.chdir(given)
    if name == "replay" and not (given / "swept").exists():
        assert ended(*SWEEP, "--out", "swept")[0] == 0
    left = on_small_disks(ended, tmp_path, LIGHT[name], SHARES, monkeypatch)
    if name in ("simulate", "sweep", "replay", "check"):
        assert all("result.json" in one for one in left)


@pytest.mark.slow
@pytest.mark.parametrize("name", HEAVY)
def test_a_long_command_on_a_full_disk_leaves_whole_files(name, given, ended, tmp_path, monkeypatch):
    if name in MEASURED and emps.find_folder() is None:
        pytest.skip("the EMPS files are not here")
    monkeypatch.chdir(given)
    left = on_small_disks(ended, tmp_path, HEAVY[name], SHARES[1:], monkeypatch)
    # before its first number a command leaves the folder as it was, but for what it continues from
    assert all("result.json" in one for one in left if one - CONTINUED_FROM or name not in CONTINUED)
