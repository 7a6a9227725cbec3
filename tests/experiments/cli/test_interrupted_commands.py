"""Long commands, each interrupted and killed at many random moments: they end in time, leave no process behind and no
file cut, hold what they said that they hold, and end with the numbers of a run that was left alone.
"""

import csv
import io
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pyarrow.parquet as pq
import pytest

from diffdrive.axis_file.drive_file import write_axis
from diffdrive.logs import write_log
from experiments.studies.emps import axis as emps
from tests.experiments.cli.test_tune_command import DRIVE as TUNED
from tests.experiments.cli.test_tune_command import QUICK
from tests.support.identify_command import MOTION, QUESTION
from tests.support.sound_log import DRIVE, axis_of, simulate_log, two_sines

pytestmark = [pytest.mark.skipif(os.name == "nt", reason="POSIX signals"), pytest.mark.slow]

MOMENTS = int(os.environ.get("DIFFDRIVE_MOMENTS", "10"))  # of each kind of interruption
WITHIN_FIRST, WITHIN_SECOND = 15.0, 5.0  # s
APART = 1.0  # s, between two signals
KINDS = {
    "SIGINT": (signal.SIGINT,),
    "SIGTERM": (signal.SIGTERM,),
    "SIGTERM twice": (signal.SIGTERM, signal.SIGTERM),
    "SIGKILL": (signal.SIGKILL,),
}
CODE = "from experiments.cli.main import main; main()"


class Command(NamedTuple):
    """A command line without its --out, and what of its folder must be the same however often it was stopped."""

    words: tuple[str, ...]
    numbers: Callable[[Path], object]


def result(folder):
    return json.loads((folder / "result.json").read_text())


def tuned(folder):
    found = result(folder)
    return found["tables"]["gains"], found["tuning"]["steps"], (folder / "tuned.toml").read_bytes()


def identified(folder):
    found = result(folder)
    return found["tables"], found["search"], found["starts"], (folder / "identified.toml").read_bytes()


def diagnosed(folder):
    return (folder / "diagnosis.json").read_bytes(), (folder / "augmented.toml").read_bytes()


def swept(folder):
    found = result(folder)
    parts = [pq.read_table(path) for path in sorted((folder / "parts").glob("*.parquet"))]
    return found["tables"], found["results"], [part.to_pydict() for part in parts]


def withheld(folder):
    answers = [json.loads(path.read_text()) for path in sorted(folder.glob("answers/*/diagnosis.json"))]
    for one in answers:
        del one["seconds"]
    return answers, json.loads((folder / "key.json").read_text()), result(folder)["scorecard"]


def recovered(folder):
    draws = [json.loads(line) for line in (folder / "draws.jsonl").read_text().splitlines()]
    return sorted((one["draw"], json.dumps(one["rows"])) for one in draws), result(folder)["tables"]


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    return tmp_path_factory.mktemp("given")


@pytest.fixture(scope="module")
def commands(given):
    here = given
    (here / "tuned.toml").write_text(TUNED)
    true = axis_of()
    write_log(here / "lap.csv", simulate_log(true, MOTION, seed=1))
    write_axis(here / "drive.toml", true)
    write_log(here / "sines.parquet", simulate_log(DRIVE, two_sines(1.0)))
    write_axis(here / "sines.toml", DRIVE)
    motion = "sine:amplitude=1mm,frequency=10Hz,duration=0.2s"
    sweep = ("sweep", here / "sines.toml", "--spread", "3%", "--samples", 8192, "--motion", motion, "--settle", 0.05)
    texts = {
        "tune": ("tune", here / "tuned.toml", *QUICK),
        "identify": ("identify", here / "lap.csv", "--drive", here / "drive.toml", *QUESTION),
        "diagnose": ("diagnose", here / "sines.parquet", "--drive", here / "sines.toml", "--most-effects", 1),
        "sweep": sweep,
        "sweep --workers": (*sweep, "--workers", 2),
        "withheld": ("withheld", "--cases", 1, "--workers", 2),
        "recovery": ("recovery", "--draws", 2, "--workers", 2),
    }
    numbers = {
        "tune": tuned, "identify": identified, "diagnose": diagnosed, "sweep": swept, "sweep --workers": swept,
        "withheld": withheld, "recovery": recovered,
    }  # fmt: skip
    return {name: Command(tuple(map(str, words)), numbers[name]) for name, words in texts.items()}


def begun(command, out, cache):
    return subprocess.Popen(
        [sys.executable, "-c", CODE, *command.words, "--out", str(out)], start_new_session=True, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=os.environ | {"JAX_COMPILATION_CACHE_DIR": str(cache)},
    )  # fmt: skip


def nobody_left(group):
    """Whether the processes of a group have ended within some seconds."""
    until = time.monotonic() + 5.0
    while time.monotonic() < until:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.05)
    os.killpg(group, signal.SIGKILL)
    return False


READ = {
    ".json": lambda path: json.loads(path.read_text()),
    ".jsonl": lambda path: path.read_text(),
    ".toml": lambda path: tomllib.loads(path.read_text()),
    ".csv": lambda path: list(csv.reader(path.read_text().splitlines())),
    ".npz": lambda path: dict(np.load(io.BytesIO(path.read_bytes()), allow_pickle=False)),
    ".parquet": pq.read_table,
    ".png": lambda path: path.read_bytes()[-8:-4] == b"IEND" or path.unlink(),
    ".html": lambda path: path.read_text().rstrip().endswith("</html>") or path.unlink(),
}


def cut(out):
    """The files that cannot be read, those aside that are not yet what they will be."""
    odd = []
    for path in out.rglob("*") if out.exists() else ():
        if path.is_dir() or path.name.startswith(".") or path.suffix == ".part":
            continue
        try:
            READ[path.suffix](path)
        except Exception as problem:
            odd.append(f"{path.relative_to(out)}: {problem}")
    return odd


def promised(said, out):
    """What the last words name, and what of it is not there."""
    words = re.findall(r"holds, of this run: (.*?)(?:;|$)", said, re.MULTILINE)
    names = [re.sub(r" \(\d+ files?\)$", "", one) for one in words[-1].split(", ")] if words else []
    return [name for name in names if not (out / name).exists()]


def stopped(command, out, cache, kind, after, where):
    """A command that is stopped after so many seconds: its exit code (0 if it ended by itself), and the time that took.

    However it was stopped: no process is left, no file is cut, and what it says that it kept is there.
    """
    with begun(command, out, cache) as process:
        time.sleep(after)
        by_itself = process.poll() is not None
        sent = time.monotonic()
        for again, one in enumerate(KINDS[kind]):
            time.sleep(APART * bool(again))
            process.send_signal(one)
            sent = time.monotonic()
        said = process.communicate()[0]
        seconds = time.monotonic() - sent
    assert nobody_left(process.pid), f"{where}: processes left"
    assert cut(out) == [], where
    assert promised(said, out) == [], where
    ends = (0, 3) if by_itself else (0, 3, 130, *(-one for one in KINDS[kind]))
    assert process.returncode in ends, f"{where}: {said}"
    if process.returncode != 0 and not by_itself:
        assert seconds < (WITHIN_SECOND if len(KINDS[kind]) > 1 else WITHIN_FIRST), f"{where}: {seconds:.1f} s"
    return (0 if by_itself else process.returncode), seconds


def moments(draw):
    """The kinds of interruption, each so often, in a random order."""
    kinds = [kind for kind in KINDS for _ in range(MOMENTS)]
    draw.shuffle(kinds)
    return kinds


def longest(rows):
    return ", ".join(f"{kind} {max(some):.1f} s of {len(some)}" for kind, some in rows.items())


CONTINUED = ("tune", "identify", "diagnose", "sweep", "sweep --workers", "withheld", "recovery")


@pytest.mark.parametrize("name", CONTINUED)
def test_killed_again_and_again_it_ends_in_time_and_with_the_same_numbers(commands, name, tmp_path, capsys):
    command, cache = commands[name], tmp_path / "cache"
    alone = tmp_path / "alone"
    for _ in range(2):  # the second time compiled
        shutil.rmtree(alone, ignore_errors=True)
        began = time.monotonic()
        with begun(command, alone, cache) as process:
            said = process.communicate()[0]
        assert process.returncode == 0, said
        lasts = time.monotonic() - began
    expected, seed = command.numbers(alone), random.randrange(10**6)
    draw, out, ends, rows = random.Random(seed), tmp_path / "out", 0, {}
    for number, kind in enumerate(moments(draw)):
        cold = tmp_path / f"cold-{number}" if draw.random() < 0.25 else cache
        where = f"{name}, seed {seed}, moment {number}: {kind}"
        code, seconds = stopped(command, out, cold, kind, draw.uniform(2.0, lasts), where)
        if code != 0:
            rows.setdefault(kind, []).append(seconds)
        else:
            assert command.numbers(out) == expected, where
            shutil.rmtree(out)
            ends += 1
    with begun(command, out, cache) as process:
        said = process.communicate()[0]
    assert process.returncode == 0, said
    assert command.numbers(out) == expected, f"seed {seed}"
    with capsys.disabled():
        print(f"\n{name} ({lasts:.0f} s alone): longest time to the end {longest(rows)}; {ends + 1} ended, all equal")


# commands that begin anew, and until when they are stopped
ANEW = {
    "simulate": ("simulate", "sines.toml", "--motion", "sine:amplitude=1mm,frequency=10Hz,duration=30s"),
    "check": ("check", "lap.csv", "--drive", "drive.toml"),
    "demo": ("demo", "--quick"),
    "reproduce": ("reproduce",),
    "log-study": ("log-study", "--cases", "8", "--sound", "4", "--pairs", "3"),
    "bench": ("bench",),
    "tuning-study": ("tuning-study", "--evaluations", "50", "--runs", "1", "--starts", "1"),
    "evolution": ("evolution", "--seconds", "5", "--runs", "1"),
    "emps": ("emps",),
    "real-axes": ("real-axes",),
}
MEASURED = ("evolution", "emps", "real-axes")  # which need the benchmark's files
AT_MOST = 20.0  # s


@pytest.mark.parametrize("name", ANEW)
def test_stopped_at_any_moment_it_ends_in_time_and_cuts_nothing(commands, given, name, tmp_path, capsys):
    if name in MEASURED and emps.find_folder() is None:
        pytest.skip("the EMPS files are not here")
    words = tuple(str(given / word) if word.endswith((".toml", ".csv")) else word for word in ANEW[name])
    command, seed, rows = Command(words, result), random.randrange(10**6), {}
    draw, out = random.Random(seed), tmp_path / "out"
    for number, kind in enumerate(moments(draw)):
        where = f"{name}, seed {seed}, moment {number}: {kind}"
        code, seconds = stopped(command, out, tmp_path / "cache", kind, draw.uniform(1.0, AT_MOST), where)
        if code == 0:
            shutil.rmtree(out)
        else:
            rows.setdefault(kind, []).append(seconds)
    assert rows, "it always ended by itself, before it was stopped"
    with capsys.disabled():
        print(f"\n{name}: longest time to the end {longest(rows)}")
