"""`diffdrive withheld`: draw machines, have them diagnosed by a process that cannot see the key, score the answers."""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from experiments.report import Report
from experiments.withheld import again
from experiments.withheld.generate import generate, write_key
from experiments.withheld.score import read_answers, read_key, score

SHOWN = (
    "cases", "clear_single", "top1_clear", "declared_clear", "top2_clear", "faint_single", "top1_faint",
    "confidently_wrong_faint", "confidently_wrong", "none", "false_alarms", "outside", "unknown_recall", "compounds",
    "both_found", "calibration_error", "median_parameter_error", "median_shrink_held_out", "median_shrink_of_oracle",
)  # fmt: skip


def withheld(out: Path, count: int, seed: int, workers: int = 1, twice: bool = False) -> dict[str, Any]:
    """Run the check, or what is left of it, in the folder `out`; the answering process is given the logs' folder."""
    with Report(f"withheld-effect check: {count} machines, seed {seed}", out) as report:
        cases = out / "cases"
        with report.stages() as progress:
            for done, _ in enumerate(generate(cases, seed, count), start=1):
                progress("drawing machines", done, count)
        _ask(report, cases, out / "answers", workers)
        return _tell(report, cases, write_key(out / "key.json", seed, count), workers, twice)


def examined(out: Path, cases: Path, key: Path, workers: int = 1, twice: bool = False) -> dict[str, Any]:
    """The same on machines that are there, such as a bench's: a folder for each, and the key to all."""
    with Report(f"withheld-effect check: {cases.name}", out) as report:
        _ask(report, cases, out / "answers", workers)
        return _tell(report, cases, read_key(key), workers, twice)


def _ask(report: Report, cases: Path, answers: Path, workers: int, without: Path | None = None) -> None:
    report.say(f"diagnosing into {answers.name}, in a process that has neither key nor seed ...")
    command = [sys.executable, "-m", "experiments.withheld.answer", str(cases), str(answers), str(workers)]
    subprocess.run([*command, *([] if without is None else [str(without)])], check=True)


def _asked_again(report: Report, cases: Path, name: str, wanted: dict[str, list[str]], workers: int) -> again.Answers:
    assert report.out is not None
    path = report.out / f"{name}.json"
    path.write_text(json.dumps(wanted, indent=1) + "\n", encoding="utf-8")
    _ask(report, cases, report.out / name, workers, path)
    return read_answers(report.out / name)


def _tell(report: Report, cases: Path, key: dict[str, dict[str, Any]], workers: int, twice: bool) -> dict[str, Any]:
    assert report.out is not None
    answers = read_answers(report.out / "answers")
    oracle: again.Answers = {}
    if twice:
        oracle = _asked_again(report, cases, "oracle", again.oracle(answers, key), workers)
        removed = again.removed(answers, key)
        without = _asked_again(report, cases, "removed", removed, workers)
        report.table(
            "removed",
            ("effect", "case", "verdict without it", "found", "declared before", "as it must be"),
            again.without_it(answers, without, removed),
            "The catalogue without the true effect: unknown, or a declared rival",
        )
    card = score(answers, key, oracle)
    report.values("scorecard", **{name: card[name] for name in SHOWN})
    report.table(
        "answers",
        ("case", "true", "size", "visibility", "verdict", "found", "confidence", "seconds"),
        [
            [
                row["case"],
                " + ".join(row["true"]) or "none",
                ", ".join(map(str, row["size"])),
                row["visibility"],
                row["verdict"],
                " + ".join(row["found"]),
                ", ".join(f"{confidence:.2f}" for _, confidence, _ in row["sure"]),
                row["seconds"],
            ]
            for row in card["rows"]
        ],
        "Answers",
    )
    report.table("reliability", ("confidence", "causes", "right"), card["reliability"], "What the confidences meant")
    report.data["confusion"] = card["confusion"]
    return card
