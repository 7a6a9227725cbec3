"""The logged command against the drive file's controller, and against mass and friction: findings in words."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import UnknownController
from diffdrive.logs.checks import balance, consistency, rivals, words
from diffdrive.logs.checks.clock import WRONG_RATE, is_decimated
from diffdrive.logs.checks.consistency import EXPLAINED, RELATED, ConsistencyResult
from diffdrive.logs.checks.explanation import WRONG_UNIT
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.relation import ControllerRelation, controller_relation
from diffdrive.logs.checks.repair import Repair, shift_signal
from diffdrive.logs.checks.replay import is_memoryless
from diffdrive.logs.checks.statistics import percent, sampling_period
from diffdrive.logs.log import Log, Signal

# A structure that leaves more than this of the command explains nothing.
EXPLAINS = 0.2


class CommandCheck(NamedTuple):
    """What the command shows, and the controller's own command [n] for the mended log, where it explains that."""

    findings: list[Finding]
    given: Signal | None = None


def check_command(log: Log, description: Axis) -> CommandCheck:
    """The command against the controller, or where that does not answer, against the balance of forces."""
    periods = sampling_period(log) * description.sampling.rate
    if abs(periods - 1.0) > WRONG_RATE:  # the clock says so; at another rate no controller is replayed
        return CommandCheck([*balance.check_force_balance(log, description)] if is_decimated(periods) else [])
    unknown = isinstance(description.controller, UnknownController)
    relation = None if unknown else controller_relation(log, description)
    outcome = None if relation is None else consistency.explain_command(relation)
    if outcome is None:
        return CommandCheck([*balance.check_force_balance(log, description)])
    fit = outcome.best.fit
    assert fit is not None
    if fit.error > EXPLAINS and outcome.plain.error > RELATED:
        return CommandCheck(
            [*unexplained_command(outcome, description), *balance.check_force_balance(log, description)]
        )
    counted_twice = [*disturbance_in_command(log, outcome)]
    mended = _repaired_relation(log, outcome, description)
    dynamics = outcome.best.dynamics
    if mended is not None and len(outcome.best.signals.command) != len(outcome.output):  # judged on a stretch
        dynamics = mended.dynamics(mended.logged)
    findings = [
        *fault_findings(log, outcome, description),
        *counted_twice,
        *unexplained_command(outcome, description),
        *([] if counted_twice else balance.other_machine(dynamics, description)),
        *confirmed_timing(outcome, description),
    ]
    return CommandCheck(findings, None if mended is None else _controller_command(log, outcome, mended))


def _repaired_relation(log: Log, outcome: ConsistencyResult, description: Axis) -> ControllerRelation | None:
    """The relation over the whole log as it would be if the best explanation is right."""
    steps = tuple(step for one in outcome.best.faults for step in one.steps)
    return controller_relation(Repair(steps).apply(log), description) if steps else outcome.relation


def _controller_command(log: Log, outcome: ConsistencyResult, relation: ControllerRelation) -> Signal | None:
    """The controller's command as the mended log would hold it, where it explains a log in one piece."""
    whole = len(outcome.output) == len(log.time) and outcome.relation.disturbance is None
    unexplained_command = (outcome.output, outcome.plain) if relation is outcome.relation else relation.plain()
    if not whole or unexplained_command is None or unexplained_command[1].error > EXPLAINS:
        return None
    output, fit = unexplained_command
    return float(fit.coefficients[0]) * output + float(fit.coefficients[-1])


def confirmed_timing(outcome: ConsistencyResult, description: Axis) -> Iterator[Finding]:
    """That no channel is shifted, where the drive file states a delay, which may stand in the recording."""
    delay = description.drive.actuator.delay_samples
    if not delay:
        return
    if any(one.cause not in ("gain", "reversed", "offset") for one in outcome.best.faults):
        return
    early, now, late = _errors_when_shifted(outcome)
    if outcome.plain.error < 0.1 and min(early, late) > 2 * now:
        also = f", so actuator.delay_samples = {delay} must lie between the command and the force"
        over = " over the later half of the log, its past being unknown" if outcome.relation.late else ""
        yield Finding(
            "note",
            "command",
            f"the drive file's controller gives the logged command to {percent(now)} % at shift 0{over}, one "
            f"sample earlier to {percent(early)} %, one later to {percent(late)} %: no unit delay is in the "
            f"recording{also}",
            "nothing to mend: command, reference and position are recorded in time",
            "shifted",
        )


def _errors_when_shifted(outcome: ConsistencyResult) -> tuple[float, float, float]:
    """Relative errors with the controller's output one sample early, in time, and one late."""
    relation, plain = outcome.relation, outcome.plain
    given, gain = relation.judged(relation.logged.command), plain.coefficients[0]
    changes = (relation.judged(outcome.output - shift_signal(outcome.output, s)) for s in (-1, 0, 1))
    misses = (plain.residual + gain * change for change in changes)
    early, now, late = (float(np.linalg.norm(miss) / np.linalg.norm(given)) for miss in misses)
    return early, now, late


def fault_findings(log: Log, outcome: ConsistencyResult, description: Axis) -> Iterator[Finding]:
    """What the best explanation says. Where the log does not rule out another one, no mend is certain."""
    best, unsure = outcome.best, rivals.causes_of(outcome.best, outcome.rivals)
    mendable = not outcome.rivals and all(one.steps for one in best.faults)
    sound = any(not one.faults for one in outcome.rivals)
    doubts = rivals.rivals_text(
        best, outcome.rivals, lambda fault: words.describe_fault(fault, log, outcome, description).remedy
    )
    for fault in best.faults:
        said = words.describe_fault(fault, log, outcome, description)
        severity = "warning" if sound and said.severity == "fatal" else said.severity
        repair = Repair(fault.steps) if mendable else None
        yield Finding(
            severity, said.channel, said.message, said.remedy + doubts, fault.cause, unsure, repair,
            said.resembles, said.amount, said.invalidates_log and not sound,
        )  # fmt: skip


def disturbance_in_command(log: Log, outcome: ConsistencyResult) -> Iterator[Finding]:
    """How much of the known disturbance is in the command: none, if it is a force beside the command."""
    fit = outcome.best.fit
    if outcome.relation.disturbance is None or fit is None or len(fit.coefficients) < 3:
        return
    ratio, inside = float(fit.coefficients[0]), float(fit.coefficients[-2])
    if abs(inside) * np.std(log.disturbance) < max(10 * fit.error, 1e-3) * np.std(log.command) or ratio == 0:
        return
    newtons = inside / ratio
    right = abs(newtons - 1) < 0.02
    raw = f" ({inside:.5g} units of the command)" if abs(ratio - 1) > WRONG_UNIT else ""
    yield Finding(
        "warning" if right else "fatal",
        "disturbance",
        f"the command contains {newtons:.5g} N per unit of the disturbance{raw}"
        + (": the disturbance is counted twice" if right else ": its scale is wrong, and it is counted twice"),
        "subtract it from the command" + ("" if right else f", and multiply the disturbance by {newtons:.5g}"),
        "disturbance",
    )


def unexplained_command(outcome: ConsistencyResult, description: Axis) -> Iterator[Finding]:
    """A controller that is not, or not quite, the one that made this command."""
    fit = outcome.best.fit
    assert fit is not None
    # digits and rows that are missing leave more than that
    if fit.error > EXPLAINED and not any(one.cause in ("rounded", "decimated") for one in outcome.best.faults):
        yield Finding(
            "warning",
            "command",
            f"the drive file's controller gives the logged command only to {percent(min(fit.error, 1.0))} %, whatever "
            "the shift and the scale",
            "another kind of controller, other gains, a filter, or something that is added to the command"
            + ("" if is_memoryless(description.controller) else "; or what it remembered: log a longer motion"),
            "other controller",
        )
