"""The logged command against the drive file's controller, and against mass and friction: findings in words."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks import balance, consistency, fault_texts, rivals
from diffdrive.logs.checks.clock import WRONG_RATE, is_decimated
from diffdrive.logs.checks.consistency import EXPLAINED, RELATED, ConsistencyResult
from diffdrive.logs.checks.explanation import WRONG_UNIT
from diffdrive.logs.checks.finding import Finding, Severity
from diffdrive.logs.checks.relation import ControllerRelation, controller_relation
from diffdrive.logs.checks.repair import Repair, shift_signal
from diffdrive.logs.checks.statistics import percent, sampling_period
from diffdrive.logs.log import Log, Signal

# A structure that leaves more than this of the command explains nothing.
EXPLAINS = 0.2


class CommandCheck(NamedTuple):
    """What the command shows, and the controller's own command [n] (N) for the repaired log, where it explains that."""

    findings: list[Finding]
    controller_command: Signal | None = None


def check_command(log: Log, axis: Axis) -> CommandCheck:
    """The command against the controller or, where that is undecided, against the balance of forces."""
    periods = sampling_period(log) * axis.sampling.rate
    if abs(periods - 1.0) > WRONG_RATE:  # the clock says so; at another rate no controller is replayed
        return CommandCheck([*balance.check_force_balance(log, axis)] if is_decimated(periods) else [])
    relation = controller_relation(log, axis) if axis.controller.can_simulate else None
    result = None if relation is None else consistency.explain_command(relation)
    if result is None:
        return CommandCheck([*balance.check_force_balance(log, axis)])
    fit = result.best.fit
    assert fit is not None
    if fit.error > EXPLAINS and result.fit_as_logged.error > RELATED:
        return CommandCheck([*unexplained_command(result, axis), *balance.check_force_balance(log, axis)])
    disturbance_findings = [*disturbance_in_command(log, result)]
    repaired = _repaired_relation(log, result, axis)
    dynamics = result.best.dynamics
    is_of_stretch = len(result.best.signals.command) != len(result.controller_command)
    if repaired is not None and is_of_stretch:
        dynamics = repaired.dynamics(repaired.logged)
    findings = [
        *fault_findings(log, result, axis),
        *disturbance_findings,
        *unexplained_command(result, axis),
        *([] if disturbance_findings else balance.other_machine(dynamics, axis)),
        *confirmed_timing(result, axis),
    ]
    return CommandCheck(findings, None if repaired is None else _controller_command(log, result, repaired))


def _repaired_relation(log: Log, result: ConsistencyResult, axis: Axis) -> ControllerRelation | None:
    """The relation over the whole log as it would be if the best explanation is right."""
    steps = tuple(step for fault in result.best.faults for step in fault.steps)
    return controller_relation(Repair(steps).apply(log), axis) if steps else result.relation


def _controller_command(log: Log, result: ConsistencyResult, relation: ControllerRelation) -> Signal | None:
    """The controller's command as the repaired log would hold it, where it explains a log in one piece."""
    is_whole = len(result.controller_command) == len(log.time) and result.relation.disturbance is None
    replay = (
        (result.controller_command, result.fit_as_logged)
        if relation is result.relation
        else relation.replay_as_logged()
    )
    if not is_whole or replay is None or replay[1].error > EXPLAINS:
        return None
    output, fit = replay
    return float(fit.coefficients[0]) * output + float(fit.coefficients[-1])


def confirmed_timing(result: ConsistencyResult, axis: Axis) -> Iterator[Finding]:
    """A note that no channel is shifted, where the drive file states a delay that might be one of the recording."""
    delay = axis.drive.actuator.delay_samples
    if not delay:
        return
    if any(fault.cause not in ("gain", "reversed", "offset") for fault in result.best.faults):
        return
    error_early, error_now, error_late = _errors_when_shifted(result)
    if result.fit_as_logged.error < 0.1 and min(error_early, error_late) > 2 * error_now:
        delay_text = f", so actuator.delay_samples = {delay} must lie between the command and the force"
        transient_text = (
            " over the later half of the log, its past being unknown" if result.relation.after_transient else ""
        )
        yield Finding(
            "note",
            "command",
            f"the drive file's controller gives the logged command to {percent(error_now)} % at shift "
            f"0{transient_text}, one sample earlier to {percent(error_early)} %, one later to {percent(error_late)} %: "
            f"no unit delay is in the recording{delay_text}",
            "no action needed: command, reference and position are recorded in time",
            "shifted",
        )


def _errors_when_shifted(result: ConsistencyResult) -> tuple[float, float, float]:
    """Relative errors with the controller's output one sample early, in time, and one late."""
    relation, as_logged = result.relation, result.fit_as_logged
    command, gain = relation.valid_samples(relation.logged.command), as_logged.coefficients[0]
    changes = (
        relation.valid_samples(result.controller_command - shift_signal(result.controller_command, samples))
        for samples in (-1, 0, 1)
    )
    residuals = (as_logged.residual + gain * change for change in changes)
    early, now, late = (float(np.linalg.norm(residual) / np.linalg.norm(command)) for residual in residuals)
    return early, now, late


def fault_findings(log: Log, result: ConsistencyResult, axis: Axis) -> Iterator[Finding]:
    """Findings of the best explanation. Where the log does not rule out another one, no repair is certain."""
    best, rival_causes = result.best, rivals.causes_of(result.best, result.rivals)
    is_repairable = not result.rivals and all(fault.steps for fault in best.faults)
    may_be_sound = any(not rival.faults for rival in result.rivals)
    rivals_note = rivals.rivals_text(
        best, result.rivals, lambda fault: fault_texts.describe_fault(fault, log, result, axis).remedy
    )
    for fault in best.faults:
        text = fault_texts.describe_fault(fault, log, result, axis)
        severity: Severity = "warning" if may_be_sound and text.severity == "fatal" else text.severity
        repair = Repair(fault.steps) if is_repairable else None
        yield Finding(
            severity, text.channel, text.message, text.remedy + rivals_note, fault.cause, rival_causes, repair,
            text.resembles, text.amount, text.invalidates_log and not may_be_sound,
        )  # fmt: skip


def disturbance_in_command(log: Log, result: ConsistencyResult) -> Iterator[Finding]:
    """How much of the known disturbance is in the command: none, if it is a force beside the command."""
    fit = result.best.fit
    if log.disturbance is None or result.relation.disturbance is None or fit is None or len(fit.coefficients) < 3:
        return
    ratio, content = float(fit.coefficients[0]), float(fit.coefficients[-2])
    if abs(content) * np.std(log.disturbance) < max(10 * fit.error, 1e-3) * np.std(log.command) or ratio == 0:
        return
    content_in_newtons = content / ratio
    is_in_newtons = abs(content_in_newtons - 1) < 0.02
    raw_text = f" ({content:.5g} units of the command)" if abs(ratio - 1) > WRONG_UNIT else ""
    yield Finding(
        "warning" if is_in_newtons else "fatal",
        "disturbance",
        f"the command contains {content_in_newtons:.5g} N per unit of the disturbance{raw_text}"
        + (": the disturbance is counted twice" if is_in_newtons else ": its scale is wrong, and it is counted twice"),
        "subtract it from the command"
        + ("" if is_in_newtons else f", and multiply the disturbance by {content_in_newtons:.5g}"),
        "disturbance",
    )


def unexplained_command(result: ConsistencyResult, axis: Axis) -> Iterator[Finding]:
    """A controller that is not, or not quite, the one that made this command."""
    fit = result.best.fit
    assert fit is not None
    # digits and rows that are missing leave more than that
    if fit.error > EXPLAINED and not any(fault.cause in ("rounded", "decimated") for fault in result.best.faults):
        yield Finding(
            "warning",
            "command",
            f"the drive file's controller gives the logged command only to {percent(min(fit.error, 1.0))} %, whatever "
            "the shift and the scale",
            "another kind of controller, other gains, a filter, or something that is added to the command"
            + ("" if axis.controller.is_memoryless else "; or what it remembered: log a longer motion"),
            "other controller",
        )
