"""The diagnosis of every case in a folder, in processes of their own that know neither key nor seed.

    python -m experiments.studies.withheld.answer FOLDER OUT WORKERS [WITHOUT.json [attended]]

Cases that have an answer to the same task are skipped, so that an interrupted run continues. The optional file names
the cases to diagnose, and for each the effects that are not to be considered. An attended process ends when its
standard input does.
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
from diffdrive.runtime import configure
from diffdrive.support.atomic_write import write_text
from diffdrive.support.processes import exit_after, processes
from tuning.checked_logs import check_logs
from tuning.diagnosis.next_experiment import Experiment
from tuning.diagnosis.workflow import diagnose_checked, diagnosis_result
from tuning.identification.padding import rounded
from tuning.store.edition import code_digest

NO_EXPERIMENT = Experiment("", [], 0.0, "not asked")
ATTENDED = "attended"
BATCH = 10  # cases that a process is given at once, at most

DiagnosisTask = tuple[Path, Path, tuple[str, ...]]  # the case, where its answer goes, the effects left out


def diagnose_case(case: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """The diagnosis of one case as the command makes it, log checks included, without figures or a next motion."""
    axis = read_axis(case / "drive.toml")
    start = time.perf_counter()
    files = sorted(case.glob("log-*.parquet"))
    checked = check_logs(axis, read_logs(files, axis), files=files)
    diagnosis = diagnose_checked(axis, checked, without=without)
    answer = diagnosis_result(axis, checked, diagnosis, NO_EXPERIMENT).details
    return dict(answer) | {"seconds": round(time.perf_counter() - start, 1)}


def _diagnose_batch(tasks: Sequence[DiagnosisTask]) -> None:
    """Write the answers to tasks whose logs are alike, and print a line about each as soon as it is done."""
    for case, path, without in tasks:
        try:
            answer = diagnose_case(case, without)
        except Exception as error:  # one case that fails is a wrong answer, not the end of the study
            answer = {"verdict": "error", "says": f"{type(error).__name__}: {error}", "causes": []}
        _write_answer(case, path, without, answer)
        found = [cause["effect"] for cause in answer["causes"] if cause["found"]]
        print(f"{case.name} {answer['verdict']} {found}", flush=True)
    # other lengths and rates have other programs: they would pile up
    jax.clear_caches()  # type: ignore[no-untyped-call]  # jax declares no types of it


def _batches(tasks: Sequence[DiagnosisTask]) -> list[list[DiagnosisTask]]:
    """Tasks grouped by the length of their logs: they share compiled programs, and compiling is half of a diagnosis.

    In the order of their first cases: a study that is broken off has answered the lengths that were drawn first, of
    whatever axis and rate.
    """
    by_length: dict[int, list[DiagnosisTask]] = {}
    for task in tasks:
        by_length.setdefault(_padded_length(task[0]), []).append(task)
    groups = [group[k : k + BATCH] for group in by_length.values() for k in range(0, len(group), BATCH)]
    return sorted(groups, key=lambda group: group[0][0].name)


def _padded_length(case: Path) -> int:
    """Samples of a case's logs as padded for compilation; 0 where they cannot be read, as the diagnosis will say."""
    try:
        return max(rounded(parquet.read_metadata(path).num_rows) for path in case.glob("log-*.parquet"))
    except (OSError, ValueError):
        return 0


def _write_answer(case: Path, path: Path, without: tuple[str, ...], answer: dict[str, object]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, json.dumps(answer | {"question": task_digest(case, without)}, indent=1) + "\n")


def _start_process() -> None:
    _edition()  # the code as it is imported, whatever becomes of it meanwhile
    configure()


def case_folders(folder: Path) -> list[Path]:
    """The cases of `folder`."""
    return sorted(path.parent for path in folder.glob("*/drive.toml"))


def task_digest(case: Path, without: Sequence[str]) -> str:
    """A digest of the task: the drive file, the logs, the excluded effects, and the edition of the code."""
    digest = hashlib.sha256((_edition() + json.dumps(sorted(without))).encode())
    for path in (case / "drive.toml", *sorted(case.glob("log-*.parquet"))):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()


def _edition() -> str:
    """A digest of the sources of the diagnosis and of this module."""
    return code_digest(diagnose_case.__module__)


def _is_answered(case: Path, path: Path, without: Sequence[str]) -> bool:
    if not path.exists():
        return False
    answered: str | None = json.loads(path.read_text(encoding="utf-8")).get("question")
    return answered == task_digest(case, without)


def unanswered(folder: Path, out: Path, without: dict[str, list[str]] | None = None) -> list[Path]:
    """The cases of `folder`, or those of them that `without` names, whose task has no answer in `out` yet."""
    return [
        case
        for case in case_folders(folder)
        if without is None or case.name in without
        if not _is_answered(case, _answer_path(out, case), (without or {}).get(case.name, ()))
    ]


def _answer_path(out: Path, case: Path) -> Path:
    return out / case.name / "diagnosis.json"


def main(folder: Path, out: Path, workers: int = 1, without: dict[str, list[str]] | None = None) -> None:
    """Answer every case of `folder`, or those that `without` names, whose task has no answer in `out` yet.

    Where a process is killed, for want of memory perhaps, the remaining cases are diagnosed one by one; one that kills
    its process is recorded as an error.
    """

    def excluded(case: Path) -> tuple[str, ...]:
        return tuple((without or {}).get(case.name, ()))

    try:
        _diagnose_all(
            [(case, _answer_path(out, case), excluded(case)) for case in unanswered(folder, out, without)], workers
        )
    except BrokenProcessPool:
        for case in unanswered(folder, out, without):
            path = _answer_path(out, case)
            try:
                _diagnose_all([(case, path, excluded(case))], 1)
            except BrokenProcessPool as error:
                _write_answer(case, path, excluded(case), {"verdict": "error", "says": str(error), "causes": []})


def _diagnose_all(tasks: Sequence[DiagnosisTask], workers: int) -> None:
    """Diagnose all tasks in `workers` processes."""
    with processes(workers, _start_process) as pool:
        for future in as_completed([pool.submit(_diagnose_batch, batch) for batch in _batches(tasks)]):
            future.result()


if __name__ == "__main__":
    for signum in (signal.SIGINT, signal.SIGTERM):
        signal.signal(signum, lambda number, _: sys.exit(128 + number))
    folder, out, workers, *options = sys.argv[1:]
    if options[1:] == [ATTENDED]:
        exit_after(lambda: os.read(0, 1))  # which the parent process holds open
    without = json.loads(Path(options[0]).read_text(encoding="utf-8")) if options else None
    main(Path(folder), Path(out), int(workers), without)
