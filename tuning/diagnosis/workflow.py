"""`tuning.diagnose`: what an axis lacks to move as its logs do, as sure as the logs themselves allow."""

import dataclasses
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import jax
from threadpoolctl import threadpool_limits

from diffdrive.axis import Axis
from diffdrive.effects.actuator import ForceGain, LoopDelay
from diffdrive.effects.base import ScaleEffect
from diffdrive.effects.catalogue import EFFECTS, in_order, require_effects
from diffdrive.errors import DiffdriveError
from diffdrive.logs.checks.finding import Finding
from diffdrive.model.parameters import Drive
from diffdrive.results import Result, Status
from diffdrive.support.bounds import require_count, require_number
from tuning.checked_logs import CheckedLogs, checked
from tuning.diagnosis.as_json import as_json
from tuning.diagnosis.cause_words import headlines
from tuning.diagnosis.diagnose import Diagnosis, logged_of
from tuning.diagnosis.diagnose import diagnose as diagnose_drive
from tuning.diagnosis.gap.gap import drive_of
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.stretches import most_telling
from tuning.diagnosis.judgement.held_out import GapReduction
from tuning.diagnosis.judgement.rest import held_against
from tuning.diagnosis.judgement.verdict import UNSURE, Belief
from tuning.diagnosis.next_experiment import Experiment, next_experiment
from tuning.diagnosis.selection.explain import MOST_EFFECTS
from tuning.diagnosis.selection.stages import Stage, unheard
from tuning.identification.scale_noise import unstated_noise
from tuning.progress import Progress, reporting
from tuning.store.folder import FolderStore

AMOUNT_TOLERANCE = 0.3  # of what a log's fault would look like: so near is what was found, if it is that
WIDTH, LINES = 100, 25  # of a summary
NOT_SEARCHED = Experiment.none("Not looked for: the diagnosis was stopped before.")
Fatal = list[tuple[str, Finding]]  # what is wrong with which log


@dataclass(frozen=True)
class Cause:
    """One unmodelled effect, and how sure it is that it acts.

    Parameters are in SI units (`units`); a list has one number for each log where the logs differ in it.
    """

    effect: str
    confidence: float
    found: bool  # part of the explanation
    parameters: Mapping[str, Any]
    intervals: Mapping[str, Any]  # 95 %
    units: Mapping[str, str]
    indistinguishable_from: tuple[str, ...]  # what these logs cannot exclude in its place


@dataclass(frozen=True, repr=False, eq=False)
class DiagnosisResult(Result):
    """Why an axis differs from its logs.

    `verdict` is `none`, `effect` or `unknown`, `says` what it rests on; `causes` are the effects that were found, then
    those that were looked at, the surest first. `closed` is the share of the gap on held-out data that is gone with
    what was found, with its interval (None: nothing was found, or nothing was left to close). `axis` is the axis with
    what was found, None where no cause was looked for, or where `notes` say why none can be; `next_motion` what would
    decide further. `details` is what diagnosis.json holds, `diagnosis` the whole result of the search. Not ok: a log is
    so wrong that no cause was looked for.
    """

    verdict: str
    says: str
    causes: tuple[Cause, ...]
    closed: GapReduction | None
    axis: Axis | None
    next_motion: Experiment
    details: Mapping[str, Any]
    diagnosis: Diagnosis
    logs: CheckedLogs
    notes: tuple[str, ...]
    status: Status

    schema: ClassVar[str] = "diagnosis/1"

    def headline(self) -> str:
        sure = ", ".join(
            f"{cause.effect} ({100.0 * cause.confidence:.0f} % sure)" for cause in self.causes if cause.found
        )
        return f"{self.verdict.upper()}{f': {sure}' if sure else ''}"

    def summary(self) -> str:
        details = self.details
        lines = [f"{self.verdict.upper()}: {self.says}", *headlines(details["causes"])]
        lines += [details["closed"]["says"], f"Gap: {details['gap']['says']}", f"Next: {self.next_motion.says}"]
        lines += [details["left_looks_like"]] if details["left_looks_like"] else []
        lines += [details["rest"]["says"]] if details["rest"] else []
        lines += [details["scale_noise"]] if details["scale_noise"] else []
        lines += [f"{finding['log']}: {finding['found']}; {finding['mend']}" for finding in details["findings"]]
        lines += [details["logs_would_show"]] if details["logs_would_show"] and self.verdict == "none" else []
        wrapped = [part for line in lines for part in textwrap.wrap(line, WIDTH, subsequent_indent="  ")]
        cut = [*wrapped[: LINES - 1], "... and more: see details"] if len(wrapped) > LINES else wrapped
        return "\n".join(cut)

    def as_dict(self) -> dict[str, object]:
        return dict(self.details)


def diagnose(
    axis: Axis,
    logs: object,
    *,
    without: Sequence[str] = (),
    most_effects: int = MOST_EFFECTS,
    tolerance: float = TOLERANCE,
    loads: Mapping[str, float] | None = None,
    resume: str | Path | None = None,
    progress: Progress | None = None,
    on_stage: Callable[[Stage], None] | None = None,
    throw: bool = False,
) -> DiagnosisResult:
    """Find which unmodelled effects make an axis differ from its logs, and how far the gap shrinks with them.

    The logs are looked over first: a finding that is fatal caps the confidence of every cause, or forbids the search.
    Method: docs/method/diagnosis-method.md; how often it is right: docs/evidence/diagnosis-proof.md.

    Args:
        axis: What is believed of the machine, right to `tolerance` and to what its [uncertainty] says beside that.
        logs: One or several of `Log`, files, data frames or dicts of arrays [n], in both directions and at two speeds:
            every sample of the controller, or snapshots at the rate that the axis's trace states; or `CheckedLogs`,
            which are not looked over again.
        without: Effects that are not to be considered, by name.
        most_effects: How many are looked for.
        tolerance: Relative uncertainty of the axis's parameters.
        loads: Force on the guides (N) by the log's file or name, where the log does not say it.
        resume: A folder where what is finished is kept: the same call continues from it.
        progress: Called with (stage, done, of how many).
        on_stage: Called with what is known on the way, a `Stage`: its name, and what it says of the gap that
            recalibration leaves, and of what each search finds. None of it is a verdict yet.
        throw: Raise an error where a log is so wrong that no cause was looked for.

    Raises:
        LogError: A log cannot be used.
        ParameterError: No effect or log has this name, or a number cannot be.
        ResultError: No cause was looked for, with `throw`.

    Examples:
        >>> why = diagnose(axis, ["lap1.csv", "lap2.csv"])
        >>> print(why)
        >>> why.axis.write("augmented.toml")

    """
    require_effects(without, "without")
    require_count("most_effects", most_effects)
    require_number("tolerance", tolerance, above=0.0, at_most=1.0)
    (used,) = checked(axis, logs, loads=loads)
    with reporting(progress) as tell:
        found = diagnose_checked(
            axis, used, without=without, most_effects=most_effects, tolerance=tolerance, store=FolderStore.of(resume),
            progress=tell, tell=on_stage or unheard,
        )  # fmt: skip
        tell("looking for the motion that would decide", 0, 1)
        offer = next_motion_of(axis, used, found)
        tell("looking for the motion that would decide", 1, 1)
    result = diagnosis_result(axis, used, found, offer)
    return result.require_ok() if throw else result


def diagnose_checked(
    axis: Axis, used: CheckedLogs, *, most_effects: int = MOST_EFFECTS, without: Sequence[str] = (), **more: Any
) -> Diagnosis:
    """The engine's answer, as sure as the checks of the logs allow; `more` is what the engine takes."""
    most, seen = 0 if is_void(used) else most_effects, axis.as_logged()
    without = [*without, *unseen_effects(axis)]
    stretches = most_telling(used.logs, seen.drive)
    # fits run side by side, and of products with some twenty columns more threads than these only wait
    with threadpool_limits(1, user_api="blas"):
        found = diagnose_drive(
            seen.drive, seen.controller, stretches.fitted,
            most_effects=most, without=without, loop_samples=axis.loop_samples, uncertainty=axis.uncertainty, **more,
        )  # fmt: skip
    if stretches.rest and most:
        every = logged_of(seen.drive, used.logs, axis.loop_samples)
        process_noise = found.comparisons[-1].trusting
        rest = held_against(every, used.logs, stretches.fitted, found.explanation, process_noise)
        found = dataclasses.replace(found, rest=rest)
    return downgrade(found, used.fatal)


def unseen_effects(axis: Axis) -> list[str]:
    """The effects that the position of the axis's logs cannot show: errors of the screw on a scale beside the motor."""
    if axis.drive.motor_encoder is None or axis.trace.position_encoder == "motor":
        return []
    return [name for name, effect in EFFECTS.items() if issubclass(effect, ScaleEffect) and effect.of_screw]


def diagnosis_result(axis: Axis, used: CheckedLogs, found: Diagnosis, offer: Experiment) -> DiagnosisResult:
    """The result, for its readers."""
    searched = not is_void(used)
    findings = [
        {
            "log": log,
            "severity": finding.severity,
            "channel": finding.channel,
            "found": finding.message,
            "mend": finding.remedy,
        }
        for log, finding in used.notable
    ]
    noise = unstated_noise(axis.as_logged().drive, float(found.logged.noise)) if searched else ""
    details = as_json(found, offer) | {
        "logs": [log.name for log in used.logs], "findings": findings, "searched": searched, "scale_noise": noise,
    }  # fmt: skip
    causes = tuple(
        Cause(
            cause["effect"], cause["confidence"], cause["found"], cause["parameters"], cause["intervals"],
            cause["units"], tuple(cause["indistinguishable_from"]),
        )
        for cause in details["causes"]
    )  # fmt: skip
    notes = [f"{log}: {finding.message}; {finding.remedy}" for log, finding in used.notable]
    notes += [found.rest.says] if found.rest else []
    augmented = None
    if searched:
        try:
            augmented = augmented_axis(axis, found)
        except DiffdriveError as problem:
            notes.append(f"no axis holds what was found: {problem}")
    verdict = found.verdict
    status = (
        Status(True, verdict.verdict, code=verdict.verdict) if searched else Status(False, verdict.says, code="void")
    )
    return DiagnosisResult(
        verdict.verdict, verdict.says, causes, found.closed, augmented, offer, details, found, used, tuple(notes),
        status,
    )  # fmt: skip


def augmented_axis(axis: Axis, found: Diagnosis) -> Axis:
    """The axis with what was found, whose controller believes in the recalibrated machine.

    The uncertainty of an identification is left out: it was found without these effects. Raises `DiffdriveError` where
    no axis can be that.
    """
    recalibrated = axis.with_logged_drive(augmented_drive(found))
    return dataclasses.replace(recalibrated, name="augmented", uncertainty=None)


def augmented_drive(found: Diagnosis) -> Drive:
    """The recalibrated drive with the effects found, session parameters as in the first log.

    They are in the catalogue's order, whatever the order in which they were found: an axis file knows no other.
    """
    drive = jax.tree.map(float, drive_of(found.found, 0))
    return dataclasses.replace(drive, effects=in_order(drive.effects))


def next_motion_of(axis: Axis, used: CheckedLogs, found: Diagnosis) -> Experiment:
    """The motion that would decide; before any, what is to be corrected where a log is wrong."""
    if not used.fatal:
        return next_experiment(found, axis.as_logged())
    log, first = _most_urgent(found, used.fatal)
    return Experiment.none(f"Before any motion, correct {log}: {first.remedy}.")


def is_void(used: CheckedLogs) -> bool:
    """Whether a search for causes would be a waste of minutes, and the axis that it finds a trap."""
    return any(finding.invalidates_log for _, finding in used.fatal)


def downgrade(found: Diagnosis, fatal: Fatal) -> Diagnosis:
    """No sure verdict from logs with a fatal finding; where that explains what was found, it is told beside it."""
    if not fatal:
        return found
    log, first = _most_urgent(found, fatal)
    message = f"the log checks say of {log}: {first.message}"
    if first.invalidates_log:
        says = f"no cause was looked for: {message}. Correct that first: {first.remedy}"
        return dataclasses.replace(found, verdict=found.verdict._replace(verdict="unknown", says=says))
    if _unexplained(found, [(log, first)]):
        message = f"{message}. No confidence is above {UNSURE} before that is corrected: {first.remedy}"
        return dataclasses.replace(found, verdict=found.verdict.downgraded(message))
    message = f"the {first.resembles} may be the log's or the drive file's rather than the machine's: {message}"
    return dataclasses.replace(found, verdict=found.verdict.and_says(message))


def _unexplained(found: Diagnosis, fatal: Fatal) -> Fatal:
    """The fatal findings that nothing that was found resembles, in kind and in size."""
    sizes = {
        belief.effect: _fitted_amount(belief, found.logged.thinning) for belief in found.verdict.beliefs if belief.found
    }
    return [(log, finding) for log, finding in fatal if not _resembles(finding, sizes.get(finding.resembles or ""))]


def _most_urgent(found: Diagnosis, fatal: Fatal) -> tuple[str, Finding]:
    """The one to be corrected first: what voids the log, then what is nothing that was found."""
    voiding = [(log, finding) for log, finding in fatal if finding.invalidates_log]
    return (voiding or _unexplained(found, fatal) or fatal)[0]


def _fitted_amount(belief: Belief, thinning: int) -> float | None:
    """The gain, or the delay in control periods; None of other effects."""
    values = belief.fitted.model.values(belief.fitted.theta)[-1]
    if belief.effect == LoopDelay.name:
        return thinning * float(values["delay"][0])
    return float(values["gain"][0]) if belief.effect == ForceGain.name else None


def _resembles(finding: Finding, size: float | None) -> bool:
    if size is None or finding.amount is None:
        return False
    return abs(size - finding.amount) < AMOUNT_TOLERANCE * abs(finding.amount)
