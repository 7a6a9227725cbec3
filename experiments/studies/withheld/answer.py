"""The diagnosis of every case in a folder, in processes of their own that know neither key nor seed.

    python -m experiments.studies.withheld.answer FOLDER OUT WORKERS [WITHOUT.json [attended]]

Cases that have an answer to just this question are left alone, so that an interrupted run goes on. The optional file
names the cases that are wanted, and for each the effects that are not to be considered. An attended process ends when
its standard input does.
"""

import hashlib
import json
import os
import signal
import sys
import time
from collections.abc import Sequence
from concurrent.futures import as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import jax
from pyarrow import parquet

from diffdrive.axis_file.drive_file import read_axis
from diffdrive.logs import read_logs
from diffdrive.runtime import configure, enable_compilation_cache
from diffdrive.support.atomic_write import write_text
from diffdrive.support.processes import exit_after, processes
from tuning.checked_logs import check_logs
from tuning.diagnosis.diagnose import rounded
from tuning.diagnosis.next_experiment import Experiment
from tuning.diagnosis.workflow import diagnose_checked, result_of
from tuning.store.edition import edition

NO_EXPERIMENT = Experiment("", [], 0.0, "not asked")
ATTENDED = "attended"
BATCH = 10  # cases that a process is given at once, at most

DiagnosisTask = tuple[Path, Path, tuple[str, ...]]  # the case, where its answer goes, the effects left out


def diagnose_case(place: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """What the command says of one case, its checks of the logs and all; it draws nothing, and plans no motion."""
    description = read_axis(place / "drive.toml")
    began = time.perf_counter()
    files = sorted(place.glob("log-*.parquet"))
    checked = check_logs(description, read_logs(files, description), files=files)
    found = diagnose_checked(description, checked, without=without)
    told = result_of(description, checked, found, NO_EXPERIMENT).details
    return dict(told) | {"seconds": round(time.perf_counter() - began, 1)}


def _diagnose_batch(questions: Sequence[DiagnosisTask]) -> None:
    """Write the answers to questions about cases that are alike, and a line about each as soon as it is there."""
    for place, path, without in questions:
        try:
            told = diagnose_case(place, without)
        except Exception as problem:  # one case that fails is a wrong answer, not the end of the study
            told = {"verdict": "error", "says": f"{type(problem).__name__}: {problem}", "causes": []}
        _write_answer(place, path, without, told)
        found = [one["effect"] for one in told["causes"] if one["found"]]
        print(f"{place.name} {told['verdict']} {found}", flush=True)
    jax.clear_caches()  # other lengths and rates have other programs: they would pile up


def _batches(questions: Sequence[DiagnosisTask]) -> list[list[DiagnosisTask]]:
    """Questions about logs of nearly the same length side by side: they share their programs, and tracing and compiling
    these is half of a diagnosis.
    """
    alike: dict[int, list[DiagnosisTask]] = {}
    for one in questions:
        alike.setdefault(_padded_length(one[0]), []).append(one)
    longest_first = sorted(alike.items(), reverse=True)
    return [some[k : k + BATCH] for _, some in longest_first for k in range(0, len(some), BATCH)]


def _padded_length(place: Path) -> int:
    """Samples of a case's logs as their programs have them; 0 of what cannot be read, as the diagnosis will say."""
    try:
        return max(rounded(parquet.read_metadata(path).num_rows) for path in place.glob("log-*.parquet"))
    except (OSError, ValueError):
        return 0


def _write_answer(place: Path, path: Path, without: tuple[str, ...], told: dict[str, Any]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(told | {"question": task_digest(place, without)}, indent=1) + "\n")


def _start_process() -> None:
    _edition()  # the code as it is imported, whatever becomes of it meanwhile
    configure()
    enable_compilation_cache()


def case_folders(folder: Path) -> list[Path]:
    """The cases of `folder`."""
    return sorted(one.parent for one in folder.glob("*/drive.toml"))


def task_digest(place: Path, without: Sequence[str]) -> str:
    """What tells the question from any other: the drive file, the logs, the effects left out, and who is asked."""
    text = hashlib.sha256((_edition() + json.dumps(sorted(without))).encode())
    for path in (place / "drive.toml", *sorted(place.glob("log-*.parquet"))):
        text.update(path.name.encode() + path.read_bytes())
    return text.hexdigest()


def _edition() -> str:
    """What the diagnosis is made of, and what tells it."""
    return edition(diagnose_case.__module__)


def _is_answered(place: Path, path: Path, without: Sequence[str]) -> bool:
    if not path.exists():
        return False
    answered: str | None = json.loads(path.read_text(encoding="utf-8")).get("question")
    return answered == task_digest(place, without)


def unanswered(folder: Path, out: Path, without: dict[str, list[str]] | None = None) -> list[Path]:
    """The cases of `folder`, or those of them that `without` names, whose question has no answer in `out` yet."""
    return [
        one
        for one in case_folders(folder)
        if without is None or one.name in without
        if not _is_answered(one, _answer_path(out, one), (without or {}).get(one.name, ()))
    ]


def _answer_path(out: Path, place: Path) -> Path:
    return out / place.name / "diagnosis.json"


def main(folder: Path, out: Path, workers: int = 1, without: dict[str, list[str]] | None = None) -> None:
    """Answer every case of `folder`, or those that `without` names, whose question has no answer in `out` yet.

    Where a process is killed, for want of memory perhaps, the cases that are left are asked one by one, and one that
    kills its process is an error.
    """

    def leaving(place: Path) -> tuple[str, ...]:
        return tuple((without or {}).get(place.name, ()))

    try:
        _diagnose_all(
            [(place, _answer_path(out, place), leaving(place)) for place in unanswered(folder, out, without)], workers
        )
    except BrokenProcessPool:
        for place in unanswered(folder, out, without):
            path = _answer_path(out, place)
            try:
                _diagnose_all([(place, path, leaving(place))], 1)
            except BrokenProcessPool as problem:
                _write_answer(place, path, leaving(place), {"verdict": "error", "says": str(problem), "causes": []})


def _diagnose_all(questions: Sequence[DiagnosisTask], workers: int) -> None:
    """Ask each."""
    with processes(workers, _start_process) as pool:
        for one in as_completed([pool.submit(_diagnose_batch, some) for some in _batches(questions)]):
            one.result()


if __name__ == "__main__":
    for one in (signal.SIGINT, signal.SIGTERM):
        signal.signal(one, lambda number, _: sys.exit(128 + number))
    folder, out, workers, *more = sys.argv[1:]
    if more[1:] == [ATTENDED]:
        exit_after(lambda: os.read(0, 1))  # of what the process that asks holds open
    named = json.loads(Path(more[0]).read_text(encoding="utf-8")) if more else None
    main(Path(folder), Path(out), int(workers), named)
