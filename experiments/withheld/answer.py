"""The diagnosis of every case in a folder, in a process of its own that knows neither key nor seed.

    python -m experiments.withheld.answer FOLDER OUT

Cases that have an answer are left alone, so that an interrupted run goes on.
"""

import json
import sys
import time
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


def answer(place: Path, without: tuple[str, ...] = ()) -> dict[str, Any]:
    """What the diagnosis says of one case."""
    description = read_drive(place / "drive.toml")
    logs = read_logs(sorted(place.glob("log-*.parquet")), description.mapping, description.sampling.rate)
    began = time.perf_counter()
    found = diagnose(description.drive, description.controller, logs, without=without)
    told: dict[str, Any] = plain(as_json(found, UNASKED))
    return told | {"seconds": round(time.perf_counter() - began, 1)}


def main(folder: Path, out: Path) -> None:
    """Answer every case of `folder` that has no answer in `out` yet."""
    for place in sorted(one for one in folder.iterdir() if (one / "drive.toml").exists()):
        path = out / place.name / "diagnosis.json"
        if path.exists():
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            told = answer(place)
        except Exception as problem:  # one case that fails is a wrong answer, not the end of the study
            told = {"verdict": "error", "says": f"{type(problem).__name__}: {problem}", "causes": []}
        path.write_text(json.dumps(told, indent=1) + "\n", encoding="utf-8")
        print(place.name, told["verdict"], [one["effect"] for one in told["causes"] if one["found"]], flush=True)


if __name__ == "__main__":
    configure()
    keep_compiled()
    main(Path(sys.argv[1]), Path(sys.argv[2]))
