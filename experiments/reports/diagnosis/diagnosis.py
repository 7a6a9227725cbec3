"""`diffdrive diagnose`: how large the gap to the logs is, where it lies, what causes it, and how far it shrinks."""

import dataclasses
import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import drive_tables, parse_drive, read_drive, write_drive
from diffdrive.controllers import UnknownController
from diffdrive.effects.actuator import ForceGain, LoopDelay
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.logs import Log
from diffdrive.logs.checks.examine import Finding
from diffdrive.model.parameters import Drive
from diffdrive.motion.motion import Motion
from diffdrive.support.atomic_write import atomic_write, write_text
from experiments.reports.checked_logs import described, looked_over, parse_loads
from experiments.reports.diagnosis.as_json import as_json
from experiments.reports.diagnosis.figures import draw
from experiments.reports.diagnosis.page import page, tell
from experiments.reports.diagnosis.payoff import in_words, payoff
from experiments.reports.report import Report, null, plain
from tuning.diagnosis.calibration import TOLERANCE
from tuning.diagnosis.diagnose import Diagnosis, diagnose
from tuning.diagnosis.explain import MOST_EFFECTS
from tuning.diagnosis.gap import drive_of
from tuning.diagnosis.next_experiment import Experiment, next_experiment
from tuning.diagnosis.verdict import UNSURE, Belief
from tuning.gains.plan import Plan
from tuning.identification.scale_noise import unstated_noise
from tuning.store.folder import KeptParts

SAME = 0.3  # of what a log's fault would look like: so near is what was found, if it is that
NEXT = "next_reference.csv"
PARTS = "diagnosis.parts"  # finished searches, from which the same command continues
NOT_ALWAYS = ("augmented.toml", NEXT, "causes.csv", "causes.png", "payoff.csv")
NOT_YET = Experiment("", [], 0.0, "not looked for: the command was stopped before")
Fatal = list[tuple[str, Finding]]  # what is wrong with which log
FINDING = ("log", "severity", "channel", "found", "mend")


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
) -> dict[str, Any]:
    """`diffdrive diagnose`; returns what diagnosis.json holds.

    `columns`, `units`, `shifts`, `loads` are texts as on the command line; with `tuned`, the controller is tuned on the
    nominal drive and on the one with what was found, and both are judged on the latter. Raises `DriveFileError`,
    `LogError` and `ParameterError`, one line each.
    """
    if tuned and out is None:
        raise ParameterError("--tune needs --out: the drive to tune on is written there")
    for name in without:
        if name not in EFFECTS:
            raise ParameterError(f"--without {name}: no such effect; known: {', '.join(EFFECTS)}")
    description = described(drive, columns, units, shifts, paths)
    with Report(f"{drive.name}: diagnosis from {', '.join(path.name for path in paths)}", out) as report:
        logs, findings, fatal = read(report, paths, description, loads)
        parts = KeptParts.within(out, PARTS)
        with report.stages() as progress:
            found = diagnosed(
                description, logs, fatal,
                without=without, tolerance=tolerance, most_effects=most_effects, store=parts, progress=progress,
            )  # fmt: skip
        if parts is not None and parts.found:
            report.console.print(f"{parts.found} finished parts of an interrupted diagnosis were used.")
        beside = {
            "logs": [log.name for log in logs], "findings": findings, "searched": not _voided(fatal),
            "scale_noise": "" if _voided(fatal) else unstated_noise(description.drive, float(found.logged.noise)),
        }  # fmt: skip
        if report.out is not None:  # minutes were spent on it: whatever fails from here on, it is kept
            _remove_stale(report, drive)
            _save(report, as_json(found, NOT_YET) | beside, None)
        with report.working("looking for the motion that would decide"):
            offer = _mended_first(found, fatal) if fatal else next_experiment(found, description)
        told = as_json(found, offer) | beside
        tell(report, told)
        if told["scale_noise"]:
            report.say(told["scale_noise"])
        if report.out is not None:
            augmented = None if _voided(fatal) else _write(report, description, found, told["scale_noise"])
            _write_reference(report, offer.reference)
            with report.working("drawing"):
                draw(report, found, logs)
            _save(report, told, augmented)
            report.values("written", **_written(augmented, offer))
            if tuned:
                heaviest = max((float(np.max(log.load)) for log in logs if log.load is not None), default=0.0)
                told["payoff"] = _pay(report, told, description, augmented, heaviest)
                _save(report, told, augmented)  # again: what was found is not lost where the tuning is interrupted
    if parts is not None:
        parts.remove()
    return told


def read(
    report: Report, paths: Sequence[Path], description: Axis, loads: Sequence[str]
) -> tuple[tuple[Log, ...], list[dict[str, str]], Fatal]:
    """The logs, and what is wrong with them, in words and where it is fatal: that lowers the confidence, no more."""
    checked = looked_over(
        paths, description, report, name="findings", loads=parse_loads(loads, list(paths)), used=("motor_position",)
    )
    logs, found, fatal = checked.logs, checked.findings, checked.fatal
    if fatal:
        follows = "no cause is looked for" if _voided(fatal) else "and is believed accordingly"
        report.say(f"{len(fatal)} fatal: what follows is wrong as far as they are right, {follows}.")
    told = [(log, one.severity, one.channel, one.found, one.mend) for log, one in found if one.severity != "note"]
    return logs, [dict(zip(FINDING, row, strict=True)) for row in told], fatal


def _remove_stale(report: Report, drive: Path) -> None:
    """What an earlier diagnosis left in the folder and this one may not write; never the drive file that was given."""
    assert report.out is not None
    unwritten = () if "findings" in report.data.get("tables", {}) else ("findings.csv",)
    for name in (*NOT_ALWAYS, *unwritten):
        if (report.out / name).resolve() != drive.resolve():
            (report.out / name).unlink(missing_ok=True)


def diagnosed(
    description: Axis,
    logs: Sequence[Log],
    fatal: Fatal,
    *,
    most_effects: int = MOST_EFFECTS,
    **more: Any,
) -> Diagnosis:
    """The diagnosis, as sure as the checks of the logs allow; `more` is what `diagnose` takes."""
    most = 0 if _voided(fatal) else most_effects
    return doubted(diagnose(description.drive, description.controller, logs, most_effects=most, **more), fatal)


def _voided(fatal: Fatal) -> bool:
    """Whether a search for causes would be a waste of minutes, and its drive file a trap."""
    return any(one.voids for _, one in fatal)


def _strange(found: Diagnosis, fatal: Fatal) -> Fatal:
    """The fatal findings that nothing that was found resembles, in kind and in size."""
    sizes = {one.effect: _amount_of(one, found.logged.thinning) for one in found.verdict.beliefs if one.found}
    return [(log, one) for log, one in fatal if not _alike(one, sizes.get(one.resembles or ""))]


def _foremost(found: Diagnosis, fatal: Fatal) -> tuple[str, Finding]:
    """The one to be mended first: what voids the log, then what is nothing that was found."""
    voiding = [(log, one) for log, one in fatal if one.voids]
    return (voiding or _strange(found, fatal) or fatal)[0]


def _amount_of(belief: Belief, thinning: int) -> float | None:
    """The gain, or the delay in control periods; None of other effects."""
    values = belief.fitted.model.values(belief.fitted.u)[-1]
    if belief.effect == LoopDelay.name:
        return thinning * float(values["delay"][0])
    return float(values["gain"][0]) if belief.effect == ForceGain.name else None


def _alike(finding: Finding, size: float | None) -> bool:
    if size is None or finding.amount is None:
        return False
    return abs(size - finding.amount) < SAME * abs(finding.amount)


def doubted(found: Diagnosis, fatal: Fatal) -> Diagnosis:
    """No sure verdict from logs with a fatal finding; where that explains what was found, it is told beside it."""
    if not fatal:
        return found
    log, first = _foremost(found, fatal)
    told = f"the log checks say of {log}: {first.found}"
    if first.voids:
        says = f"no cause was looked for: {told}. Mend that first: {first.mend}"
        return dataclasses.replace(found, verdict=found.verdict._replace(verdict="unknown", says=says))
    if _strange(found, [(log, first)]):
        told = f"{told}. No confidence is above {UNSURE} before that is mended: {first.mend}"
        return dataclasses.replace(found, verdict=found.verdict.doubted(told))
    told = f"the {first.resembles} may be the log's or the drive file's rather than the machine's: {told}"
    return dataclasses.replace(found, verdict=found.verdict.and_says(told))


def _mended_first(found: Diagnosis, fatal: Fatal) -> Experiment:
    """No motion tells anything while what logs it is wrong."""
    log, first = _foremost(found, fatal)
    return Experiment("", [], 0.0, f"before any motion, mend {log}: {first.mend}")


def _save(report: Report, told: dict[str, Any], augmented: str | None) -> None:
    """diagnosis.json and report.html."""
    assert report.out is not None
    text = json.dumps(plain(told, null), indent=2, allow_nan=False)
    write_text(report.out / "diagnosis.json", text + "\n")
    page(report, told, augmented)


def _pay(
    report: Report, told: dict[str, Any], description: Axis, augmented: str | None, max_load: float
) -> dict[str, Any]:
    """Tune on both drives; what that tells, in words and, if there was something to tune on, each gains' numbers."""
    assert report.out is not None
    if not told["ladder"][2:]:
        says, gains = "Nothing to tune on: no effect was added.", {}
    elif augmented is None:
        says, gains = "Nothing to tune on: no drive file can say what was found.", {}
    elif isinstance(description.controller, UnknownController):
        says, gains = "Nothing to tune: the drive file does not know its controller.", {}
    else:
        plan = Plan(max_load=max_load, loads=Plan.loads if max_load > 0 else 1)
        gains = payoff(report, description, read_drive(report.out / augmented), plan)
        says = in_words(gains)
        if told["verdict"] != "effect":
            says = f"The verdict is {told['verdict']}, and what was found may not act. If it does: {says}"
    report.say(says)
    return {"says": says, "gains": gains}


def augmented_drive(found: Diagnosis) -> Drive:
    """The recalibrated drive with the effects found, session parameters as in the first log.

    They are in the catalogue's order, whatever the order in which they were found: a drive file knows no other.
    """
    drive = jax.tree.map(float, drive_of(found.found, 0))
    order = list(EFFECTS)
    return dataclasses.replace(drive, effects=tuple(sorted(drive.effects, key=lambda one: order.index(one.name))))


def _write_reference(report: Report, motion: Motion | None) -> None:
    """next_reference.csv: the motion that would decide, sample by sample, for the machine's controller to run."""
    if motion is None:
        return
    assert report.out is not None
    rows = np.stack([motion.time, motion.position], axis=1)
    with atomic_write(report.out / NEXT, "w") as file:
        np.savetxt(file, rows, delimiter=",", header="time_s,reference_m", comments="", fmt="%.9g")


def _written(augmented: str | None, offer: Experiment) -> dict[str, str]:
    """What a reader opens, and what the next command takes."""
    files = {"page": "report.html", "drive": augmented, "motion": NEXT if offer.reference is not None else None}
    return {what: file for what, file in files.items() if file is not None}


def _write(report: Report, description: Axis, found: Diagnosis, beside: str) -> str | None:
    """augmented.toml, which `simulate`, `tune` and `sweep` take, with what is to be said `beside` the verdict.

    The same gains; observers and feed-forwards, whose model is the file's own, get the recalibrated one.
    """
    assert report.out is not None
    path = report.out / "augmented.toml"
    try:
        augmented = dataclasses.replace(description, drive=augmented_drive(found))
        says = " ".join(found.verdict.says.split())  # in one line
        verdict = f"the verdict of the diagnosis was {found.verdict.verdict}: {says}"
        comments = [verdict, beside] if beside else [verdict]
        write_drive(path, parse_drive(drive_tables(augmented), str(path)), comments)
    except DiffdriveError as problem:
        report.say(f"augmented.toml is not written, since no drive file can say this: {problem}")
        return None
    return path.name
