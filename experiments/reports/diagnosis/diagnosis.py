"""`diffdrive diagnose`: how large the gap to the logs is, where it lies, what causes it, and how far it shrinks."""

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.controllers import UnknownController
from diffdrive.effects.catalogue import require_effects
from diffdrive.errors import ParameterError
from experiments.reports.checked_logs import axis_with_overrides, parse_loads, read_and_check
from experiments.reports.diagnosis.answers import Details, print_answers
from experiments.reports.diagnosis.figures import save_diagnosis_figures
from experiments.reports.diagnosis.files import AUGMENTED, NEXT, write_augmented, write_reference
from experiments.reports.diagnosis.page import give_page
from experiments.reports.diagnosis.payoff import GainFigures, payoff, summarise_payoff
from experiments.reports.report import Report
from tuning.checked_logs import CheckedLogs
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.next_experiment import Experiment
from tuning.diagnosis.selection.explain import MOST_EFFECTS
from tuning.diagnosis.selection.stages import Stage
from tuning.diagnosis.workflow import (
    NOT_SEARCHED,
    DiagnosisResult,
    diagnose_checked,
    diagnosis_result,
    is_void,
    next_motion_of,
)
from tuning.gains.plan import TuningPlan
from tuning.store.folder import FolderStore

PARTS = "diagnosis.parts"  # finished searches, from which the same command continues
NOT_ALWAYS = (AUGMENTED, NEXT, "causes.csv", "causes.png", "detection_limits.csv", "payoff.csv")


def diagnose_logs(
    paths: Sequence[Path],
    drive: Path,
    out: Path | None,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    shifts: Sequence[str] = (),
    loads: Sequence[str] = (),
    without: Sequence[str] = (),
    most_effects: int = MOST_EFFECTS,
    tolerance: float = TOLERANCE,
    tuned: bool = False,
) -> Details:
    """`diffdrive diagnose`; returns what diagnosis.json holds.

    `columns`, `units`, `shifts`, `loads` are texts as on the command line; with `tuned`, the controller is tuned on the
    nominal drive and on the one with what was found, and both are judged on the latter. Raises `DriveFileError`,
    `LogError` and `ParameterError`, one line each.
    """
    if tuned and out is None:
        raise ParameterError("--tune needs --out: the drive to tune on is written there")
    require_effects(without, "--without")
    description = axis_with_overrides(drive, columns, units, shifts, paths)
    with Report(f"{drive.name}: diagnosis from {', '.join(path.name for path in paths)}", out) as report:
        checked = read_diagnosis_logs(report, paths, description, loads)
        parts = FolderStore.in_folder(out, PARTS)
        with report.stages() as progress:
            found = diagnose_checked(
                description, checked,
                without=without, tolerance=tolerance, most_effects=most_effects, store=parts, progress=progress,
                tell=lambda stage: _keep_stage(report, stage),
            )  # fmt: skip
        if parts is not None and parts.hits:
            report.print(f"{parts.hits} finished parts of an interrupted diagnosis were used.")
        if report.out is not None:  # minutes were spent on it: whatever fails from here on, it is kept
            _remove_stale(report, drive)
            _save(report, diagnosis_result(description, checked, found, NOT_SEARCHED), None)
        with report.working("looking for the motion that would decide"):
            offer = next_motion_of(description, checked, found)
        result = diagnosis_result(description, checked, found, offer)
        details = dict(result.details)
        print_answers(report, details)
        if details["scale_noise"]:
            report.say(details["scale_noise"])
        if report.out is not None:
            augmented = write_augmented(report, result)
            write_reference(report, offer.reference)
            with report.working("drawing"):
                save_diagnosis_figures(report, found, checked.logs)
            _save(report, result, augmented)
            report.values("written", **_written(augmented, offer))
            if tuned:
                heaviest = max((float(np.max(log.load)) for log in checked.logs if log.load is not None), default=0.0)
                details["payoff"] = _pay(report, details, description, augmented, heaviest)
                _save(
                    report, dataclasses.replace(result, details=details), augmented
                )  # again: what was found is not lost where the tuning is interrupted
        if parts is not None:  # while no other run may write here
            parts.remove()
    return details


def _keep_stage(report: Report, stage: Stage) -> None:
    """Print what is known on the way, and keep it: a diagnosis that is stopped leaves it in result.json."""
    report.print(f"So far, {stage.name}: {stage.says}.")
    report.keep("so_far", **{stage.name: stage.says})


def read_diagnosis_logs(report: Report, paths: Sequence[Path], description: Axis, loads: Sequence[str]) -> CheckedLogs:
    """The logs, and what is wrong with them: where it is fatal that lowers the confidence, no more."""
    checked = read_and_check(
        paths,
        description,
        report,
        name="findings",
        loads=parse_loads(loads, list(paths), description.sheet),
    )
    if checked.fatal:
        follows = "no cause is looked for" if is_void(checked) else "and is believed accordingly"
        report.say(f"{len(checked.fatal)} fatal: what follows is wrong as far as they are right, {follows}.")
    return checked


def _remove_stale(report: Report, drive: Path) -> None:
    """What an earlier diagnosis left in the folder and this one may not write; never the drive file that was given."""
    assert report.out is not None
    unwritten = () if "findings" in report.data.get("tables", {}) else ("findings.csv",)
    for name in (*NOT_ALWAYS, *unwritten):
        if (report.out / name).resolve() != drive.resolve():
            (report.out / name).unlink(missing_ok=True)


def _save(report: Report, result: DiagnosisResult, augmented: str | None) -> None:
    """diagnosis.json and report.html."""
    assert report.out is not None
    result.save(report.out)
    give_page(report, dict(result.details), augmented)
    report.write_page()


def _pay(
    report: Report, details: Details, description: Axis, augmented: str | None, max_load: float
) -> dict[str, object]:
    """Tune on both drives; what that shows, in words and, if there was something to tune on, each gains' numbers."""
    assert report.out is not None
    gains: dict[str, GainFigures] = {}
    if not details["ladder"][2:]:
        says = "Nothing to tune on: no effect was added."
    elif augmented is None:
        says = "Nothing to tune on: no drive file can say what was found."
    elif isinstance(description.controller, UnknownController):
        says = "Nothing to tune: the drive file does not know its controller."
    else:
        plan = TuningPlan(loads=(0.0, max_load))
        gains = payoff(report, description, read_axis(report.out / augmented), plan)
        says = summarise_payoff(gains)
        if details["verdict"] != "effect":
            says = f"The verdict is {details['verdict']}, and what was found may not act. If it does: {says}"
    report.say(says)
    return {"says": says, "gains": gains}


def _written(augmented: str | None, offer: Experiment) -> dict[str, str]:
    """What a reader opens, and what the next command takes."""
    files = {"page": "report.html", "drive": augmented, "motion": NEXT if offer.reference is not None else None}
    return {what: file for what, file in files.items() if file is not None}
