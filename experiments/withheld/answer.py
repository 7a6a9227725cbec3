"""The diagnosis of every case in a folder, in processes of their own that know neither key nor seed.

    python -m experiments.withheld.answer FOLDER OUT WORKERS [WITHOUT.json]

Cases that have an answer are left alone, so that an interrupted run goes on. The optional file names the cases that are
wanted, and for each the effects that are not to be considered.
"""

import json
import multiprocessing
import sys
import time
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from diffdrive.drive_file import read_drive
from diffdrive.logs import read_logs
from experiments.diagnose import as_json
from experiments.report import plain
from experiments.runtime import configure, keep_compiled
from tuning.diagnosis.diagnose import diagnose
from tuning.diagnosis.next_experiment import Experiment

UNASKED = Experiment("", [], 0.0, "not asked")
TASKS = 4  # cases that one process answers: compiled programs pile up in it


def answer(place: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """What the diagnosis says of one case."""
    description = read_drive(place / "drive.toml")
    logs = read_logs(sorted(place.glob("log-*.parquet")), description.mapping, description.sampling.rate)
    began = time.perf_counter()
    found = diagnose(description.drive, description.controller, logs, without=without)
    told: dict[str, Any] = plain(as_json(found, UNASKED))
    return told | {"seconds": round(time.perf_counter() - began, 1)}


def _answer(place: Path, path: Path, without: tuple[str, ...]) -> str:
    """Write the answer of one case; what a line about it says."""
    try:
        told = answer(place, without)
    except Exception as problem:  # one case that fails is a wrong answer, not the end of the study
        told = {"verdict": "error", "says": f"{type(problem).__name__}: {problem}", "causes": []}
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
    part.replace(path)  # whole or not at all
    return f"{place.name} {told['verdict']} {[one['effect'] for one in told['causes'] if one['found']]}"


def _begin() -> None:
    configure()
    keep_compiled()


def unanswered(folder: Path, out: Path, without: dict[str, list[str]] | None = None) -> list[Path]:
    """The cases of `folder`, or those of them that `without` names, that have no answer in `out` yet."""
    places = sorted(one.parent for one in folder.glob("*/drive.toml"))
    return [one for one in places if (without is None or one.name in without) and not _path(out, one).exists()]


def _path(out: Path, place: Path) -> Path:
    return out / place.name / "diagnosis.json"


def main(folder: Path, out: Path, workers: int = 1, without: dict[str, list[str]] | None = None) -> None:
    """Answer every case of `folder`, or those that `without` names, that has no answer in `out` yet."""
    # spawned, not forked: a forked JAX hangs
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=_begin, max_tasks_per_child=TASKS) as pool:
        asked = [
            pool.submit(_answer, place, _path(out, place), tuple((without or {}).get(place.name, ())))
            for place in unanswered(folder, out, without)
        ]
        for one in as_completed(asked):
            print(one.result(), flush=True)


if __name__ == "__main__":
    folder, out, workers, *more = sys.argv[1:]
    named = json.loads(Path(more[0]).read_text(encoding="utf-8")) if more else None
    main(Path(folder), Path(out), int(workers), named)
