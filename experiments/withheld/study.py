"""`diffdrive withheld`: draw machines, have them diagnosed by a process that cannot see the key, score the answers."""

import subprocess
import sys
from pathlib import Path
from typing import Any

from experiments.report import Report
from experiments.withheld.generate import generate, write_key
from experiments.withheld.score import read_answers, read_key, score

SHOWN = (
    "cases", "clear_single", "top1_clear", "declared_clear", "top2_clear", "faint_single", "top1_faint",
    "confidently_wrong_faint", "none", "false_alarms", "outside", "unknown_recall", "compounds", "both_found",
    "calibration_error", "median_shrink_held_out",
)  # fmt: skip


def withheld(out: Path, count: int, seed: int) -> dict[str, Any]:
    """Run the check, or what is left of it, in the folder `out`; the answering process is given the logs' folder."""
    with Report(f"withheld-effect check: {count} machines, seed {seed}", out) as report:
        cases = out / "cases"
        with report.stages() as progress:
            for done, _ in enumerate(generate(cases, seed, count), start=1):
                progress("drawing machines", done, count)
        _ask(report, cases, out / "answers")
        return _tell(report, read_answers(out / "answers"), write_key(out / "key.json", seed, count))


def examined(out: Path, cases: Path, key: Path) -> dict[str, Any]:
    """The same on machines that are there, such as a bench's: a folder for each, and the key to all."""
    opened = read_key(key)
    with Report(f"withheld-effect check: {cases.name}", out) as report:
        _ask(report, cases, out / "answers")
        return _tell(report, read_answers(out / "answers"), opened)


def _ask(report: Report, cases: Path, answers: Path) -> None:
    report.say("diagnosing, in a process that has neither key nor seed ...")
    subprocess.run([sys.executable, "-m", "experiments.withheld.answer", str(cases), str(answers)], check=True)


def _tell(report: Report, answers: dict[str, dict[str, Any]], key: dict[str, dict[str, Any]]) -> dict[str, Any]:
    card = score(answers, key)
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
    report.data["confusion"] = card["confusion"]
    return card
