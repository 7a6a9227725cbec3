"""The logged command against the drive file's controller, and against mass and friction: findings in words."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.axis import Axis
from diffdrive.controllers import UnknownController
from diffdrive.logs.checks import balance, consistency, rivals, words
from diffdrive.logs.checks.clock import WRONG_RATE, is_decimated
from diffdrive.logs.checks.consistency import EXPLAINED, RELATED, Outcome
from diffdrive.logs.checks.explanation import WRONG_UNIT
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.relation import Relation, relation_of
from diffdrive.logs.checks.repair import Repair, shifted
from diffdrive.logs.checks.replay import remembers_nothing
from diffdrive.logs.checks.statistics import mean_step, percent
from diffdrive.logs.log import Log, Signal

# A structure that leaves more than this of the command explains nothing.
EXPLAINS = 0.2


class Judgement(NamedTuple):
    """What the command shows, and the controller's own command [n] for the mended log, where it explains that."""

    findings: list[Finding]
    given: Signal | None = None


def judged(log: Log, description: Axis) -> Judgement:
    """The command against the controller, or where that does not answer, against the balance of forces."""
    periods = mean_step(log) * description.sampling.rate
    if abs(periods - 1.0) > WRONG_RATE:  # the clock says so; at another rate no controller is replayed
        return Judgement([*balance.command(log, description)] if is_decimated(periods) else [])
    unknown = isinstance(description.controller, UnknownController)
    relation = None if unknown else relation_of(log, description)
    outcome = None if relation is None else consistency.examined(relation)
    if outcome is None:
        return Judgement([*balance.command(log, description)])
    fit = outcome.best.fit
    assert fit is not None
    if fit.error > EXPLAINS and outcome.plain.error > RELATED:
        return Judgement([*explained(outcome, description), *balance.command(log, description)])
    counted_twice = [*disturbance(log, outcome)]
    mended = _mended(log, outcome, description)
    dynamics = outcome.best.dynamics
    if mended is not None and len(outcome.best.signals.command) != len(outcome.output):  # judged on a stretch
        dynamics = mended.dynamics(mended.logged)
    findings = [
        *faults(log, outcome, description),
        *counted_twice,
        *explained(outcome, description),
        *([] if counted_twice else balance.machine(dynamics, description)),
        *timing(outcome, description),
    ]
    return Judgement(findings, None if mended is None else _given(log, outcome, mended))


def _mended(log: Log, outcome: Outcome, description: Axis) -> Relation | None:
    """The relation over the whole log as it would be if the best explanation is right."""
    steps = tuple(step for one in outcome.best.faults for step in one.steps)
    return relation_of(Repair(steps).apply(log), description) if steps else outcome.relation


def _given(log: Log, outcome: Outcome, relation: Relation) -> Signal | None:
    """The controller's command as the mended log would hold it, where it explains a log in one piece."""
    whole = len(outcome.output) == len(log.time) and outcome.relation.disturbance is None
    explained = (outcome.output, outcome.plain) if relation is outcome.relation else relation.plain()
    if not whole or explained is None or explained[1].error > EXPLAINS:
        return None
    output, fit = explained
    return float(fit.coefficients[0]) * output + float(fit.coefficients[-1])


def timing(outcome: Outcome, description: Axis) -> Iterator[Finding]:
    """That no channel is shifted, where the drive file states a delay, which may stand in the recording."""
    delay = description.drive.actuator.delay_samples
    if not delay:
        return
    if any(one.cause not in ("gain", "reversed", "offset") for one in outcome.best.faults):
        return
    early, now, late = _around(outcome)
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


def _around(outcome: Outcome) -> tuple[float, float, float]:
    """Relative errors with the controller's output one sample early, in time, and one late."""
    relation, plain = outcome.relation, outcome.plain
    given, gain = relation.judged(relation.logged.command), plain.coefficients[0]
    changes = (relation.judged(outcome.output - shifted(outcome.output, s)) for s in (-1, 0, 1))
    misses = (plain.residual + gain * change for change in changes)
    early, now, late = (float(np.linalg.norm(miss) / np.linalg.norm(given)) for miss in misses)
    return early, now, late


def faults(log: Log, outcome: Outcome, description: Axis) -> Iterator[Finding]:
    """What the best explanation says. Where the log does not rule out another one, no mend is certain."""
    best, unsure = outcome.best, rivals.causes_of(outcome.best, outcome.rivals)
    mendable = not outcome.rivals and all(one.steps for one in best.faults)
    sound = any(not one.faults for one in outcome.rivals)
    doubts = rivals.told(best, outcome.rivals, lambda fault: words.of(fault, log, outcome, description).remedy)
    for fault in best.faults:
        said = words.of(fault, log, outcome, description)
        severity = "warning" if sound and said.severity == "fatal" else said.severity
        repair = Repair(fault.steps) if mendable else None
        yield Finding(
            severity, said.channel, said.message, said.remedy + doubts, fault.cause, unsure, repair,
            said.resembles, said.amount, said.invalidates_log and not sound,
        )  # fmt: skip


def disturbance(log: Log, outcome: Outcome) -> Iterator[Finding]:
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


def explained(outcome: Outcome, description: Axis) -> Iterator[Finding]:
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
            + ("" if remembers_nothing(description.controller) else "; or what it remembered: log a longer motion"),
            "other controller",
        )
