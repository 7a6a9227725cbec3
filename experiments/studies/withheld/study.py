"""`diffdrive withheld`: draw machines, have them diagnosed by a process that cannot see the key, score the answers."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import ParameterError
from diffdrive.support.atomic_write import atomic_write
from diffdrive.support.resources import format_count, require_disk, require_memory
from experiments.reports.report import Report
from experiments.studies.withheld import reruns
from experiments.studies.withheld.answer import ATTENDED, case_folders, unanswered
from experiments.studies.withheld.axes import axes_named
from experiments.studies.withheld.generate import generate, write_key
from experiments.studies.withheld.records import Answers, Key
from experiments.studies.withheld.score import read_answers, read_key, score

SHOWN = (
    "cases", "errors", "clear_single", "named_clear", "exact_clear", "top1_clear", "declared_clear", "top2_clear",
    "drawn_clear", "named_drawn_clear", "faint_single", "named_faint", "top1_faint", "top2_faint",
    "confidently_wrong_faint", "confidently_wrong", "none", "said_none", "false_alarms", "outside", "unknown_recall",
    "unknown_clear",
    "compounds", "both_found", "both_named", "pitfalls", "pitfall_named", "calibration_error", "median_parameter_error",
    "median_shrink_held_out", "quarter_shrink_held_out", "median_shrink_of_oracle", "quarter_shrink_of_oracle",
    "shrinks_of_oracle", "oracle_asked", "interval_coverage", "intervals_told", "declared_at_once", "most_declared",
    "declared_clear_of_few",
)  # fmt: skip
CASE, PROCESS = 2e5, 2e9  # bytes at least: of a case's logs on the disk, and of a process that diagnoses
ANSWER_COMMAND = ("-m", "experiments.studies.withheld.answer")
REPOSITORY = Path(__file__).resolve().parents[3]


def require_workers(workers: int) -> None:
    """Raise `ParameterError` for more processes than fit into memory."""
    request = f"--workers {format_count(workers)}: as many processes"
    require_memory(ParameterError, request, PROCESS * (workers - 1), "give fewer")


def check_drawn_machines(
    out: Path, count: int, seed: int, workers: int = 1, twice: bool = False, axes: tuple[str, ...] = ("paper",)
) -> dict[str, object]:
    """Run or continue the check in the folder `out`, on machines drawn for these axes in turn.

    The answering process is given copies of logs and drive files in a folder of their own; the key is written after all
    answers.
    """
    drive_axes = axes_named(axes)
    require_workers(workers)
    parent = next(folder for folder in (out, *out.resolve().parents) if folder.is_dir())
    require_disk(
        ParameterError, f"--cases {format_count(count)}: their logs", parent, CASE * float(count), "give fewer"
    )
    with Report(f"withheld-effect check: {count} machines of {', '.join(axes)}, seed {seed}", out) as report:
        cases, parts = out / "cases", out / "key_parts"
        with report.stages() as progress:
            for done, _ in enumerate(generate(cases, parts, seed, count, drive_axes), start=1):
                progress("drawing machines", done, count)
        _answer_cases(report, cases, out / "answers", workers)
        return _report_scores(report, cases, write_key(out / "key.json", parts), workers, twice)


def check_given_machines(out: Path, cases: Path, key: Path, workers: int = 1, twice: bool = False) -> dict[str, object]:
    """Run the check on given machines, such as a bench's: a folder for each, and the key to all."""
    require_workers(workers)
    key_entries = _checked_key(cases, key)
    with Report(f"withheld-effect check: {cases.name}", out) as report:
        _answer_cases(report, cases, out / "answers", workers)
        return _report_scores(report, cases, key_entries, workers, twice)


def _checked_key(cases: Path, path: Path) -> Key:
    """The key to given machines, checked against them before hours are spent."""
    key = read_key(path)
    names = {folder.name for folder in case_folders(cases)}
    if not names:
        raise ParameterError(f"{cases}: no machine in it; each is a folder with a drive.toml and log-*.parquet")
    if names != key.keys():
        mismatched = ", ".join(sorted(names ^ key.keys()))
        raise ParameterError(f"{path}: names other machines than there are in {cases}; they differ in {mismatched}")
    return key


def _answer_cases(
    report: Report, cases: Path, answers: Path, workers: int, without: dict[str, list[str]] | None = None
) -> None:
    """Diagnose the cases that have no answer yet, in a process that is given them and nothing else."""
    pending = unanswered(cases, answers, without)
    if not pending:
        return
    report.say(f"diagnosing into {answers.name}, in a process that has neither key nor seed ...")
    with tempfile.TemporaryDirectory(prefix="machines-") as folder:
        workspace = Path(folder)
        for case in pending:
            (workspace / "cases" / case.name).mkdir(parents=True)
            for path in (case / "drive.toml", *sorted(case.glob("log-*.parquet"))):
                shutil.copyfile(path, workspace / "cases" / case.name / path.name)
        (workspace / "without.json").write_text(json.dumps(without), encoding="utf-8")
        command = [sys.executable, *ANSWER_COMMAND, "cases", "answers", str(workers), "without.json", ATTENDED]
        paths = os.pathsep.join([str(REPOSITORY), *filter(None, [os.environ.get("PYTHONPATH")])])
        environment = os.environ | {"PYTHONPATH": paths}
        with subprocess.Popen(
            command, cwd=workspace, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        ) as process:
            assert process.stdout is not None
            try:
                for line in process.stdout:
                    print(line, end="", flush=True)
                    _copy_answers(workspace / "answers", answers)  # one by one: an interrupted run goes on from there
            except BaseException:
                process.terminate()
                raise
            finally:
                _copy_answers(workspace / "answers", answers)
        if process.returncode:
            raise subprocess.CalledProcessError(process.returncode, command)
    if outdated := [case.name for case in unanswered(cases, answers, without)]:
        raise ParameterError(
            f"{answers}: {', '.join(outdated)} were answered by other sources than those that asked: the code was "
            "changed meanwhile; start again from a copy of it that stays as it is"
        )


def _copy_answers(source: Path, destination: Path) -> None:
    """Copy the answers that differ from those in `destination`, or are not in it yet."""
    for path in source.glob("*/diagnosis.json"):
        target, text = destination / path.parent.name / path.name, path.read_bytes()
        if target.exists() and target.read_bytes() == text:
            continue
        target.parent.mkdir(parents=True, exist_ok=True)
        with atomic_write(target) as file:
            file.write(text)


def _rerun(report: Report, cases: Path, name: str, exclusions: dict[str, list[str]], workers: int) -> Answers:
    assert report.out is not None
    _answer_cases(report, cases, report.out / name, workers, exclusions)
    answers = read_answers(report.out / name)
    return {case: answers[case] for case in exclusions if case in answers}  # not those of an earlier edition


def _in_words(card: Mapping[str, Any]) -> str:
    """The scores that matter most, each where there were machines for it."""
    parts = [
        f"{100.0 * card[name]:.0f} % of {count} {what}"
        for name, count, what in (
            ("named_clear", card["clear_single"], "clearly visible effects are named"),
            ("false_alarms", card["none"], "machines without an effect raise a false alarm"),
            ("confidently_wrong", card["cases"], "machines have a wrong cause of which the diagnosis is sure"),
        )
        if count
    ]
    return f"{'; '.join(parts)}."


def _report_scores(report: Report, cases: Path, key: Key, workers: int, twice: bool) -> dict[str, object]:
    assert report.out is not None
    answers = read_answers(report.out / "answers")
    oracle: Answers | None = None
    if twice:
        oracle = _rerun(report, cases, "oracle", reruns.oracle_exclusions(answers, key), workers)
        removed = reruns.removal_exclusions(answers, key)
        reruns_without_effect = _rerun(report, cases, "removed", removed, workers)
        report.table(
            "removed",
            ("effect", "case", "verdict without it", "found", "declared before", "as it must be"),
            reruns.removal_rows(answers, reruns_without_effect, removed),
            "The catalogue without the true effect: unknown, or a declared rival",
        )
        never_removed = sorted(set(EFFECTS) - {effect for (effect,) in removed.values()})
        if never_removed:
            report.say(f"Believed alone in no case, and so not removed: {', '.join(never_removed)}.")
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
    report.result(_in_words(card))
    for name in ("confusion", "intervals", "rows", "without_ratio"):
        report.data[name] = card[name]
    return card
