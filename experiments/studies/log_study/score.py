"""The findings of the checks in a log whose fault is known, and whether they are right."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from scipy.stats import binomtest

from diffdrive.axis import Axis
from diffdrive.logs.checks.examine import Finding
from diffdrive.logs.log import Log
from experiments.studies.log_study.fault import LogFault
from experiments.studies.log_study.repair_check import differences

MAX_REPAIRS = 3  # that a user applies one after the other


Examine = Callable[[Log, Axis], Sequence[Finding]]


@dataclass(frozen=True)
class Score:
    """How the findings in one log did. `wrong_repair` says what is wrong in the repaired log, and by which finding."""

    first: bool  # the first finding has a right cause and channel
    named: bool  # a right cause is among the causes and rivals
    rivals: bool  # so are those that cannot be ruled out
    repaired: bool  # a repair was stated, and right
    wrong_repair: str
    summary: str  # of the first finding
    severity: str


def first_finding(findings: Sequence[Finding]) -> Finding | None:
    """The finding that a user reads first: the first that is more than a note, else the first note."""
    return next((finding for finding in findings if finding.severity != "note"), findings[0] if findings else None)


def apply_repairs(log: Log, axis: Axis, examine: Examine, findings: Sequence[Finding]) -> tuple[Log, list[Finding]]:
    """The log after the repairs that a user would apply, and the findings that stated them."""
    applied: list[Finding] = []
    while len(applied) < MAX_REPAIRS:
        finding = next((finding for finding in findings if finding.repair is not None), None)
        if finding is None or finding.repair is None:
            break
        log = finding.repair.apply(log)
        applied.append(finding)
        findings = examine(log, axis)
    return log, applied


def score_fault(fault: LogFault, axis: Axis, resolution: float, examine: Examine) -> Score:
    """Examine a log with a fault, and compare with the truth."""
    findings = examine(fault.log, axis)
    top = first_finding(findings)
    first = top is not None and top.cause in fault.causes and (not fault.channels or top.channel in fault.channels)
    # every note has a cause, too: notes that only confirm name no hypothesis
    names = {name for finding in findings for name in (finding.cause, *finding.rivals)}
    repaired, applied = apply_repairs(fault.log, axis, examine, findings)
    wrong = differences(repaired, fault, resolution) if applied else []
    stated = "; ".join(
        f"{finding.severity}: {finding.channel}: {finding.message}; {finding.remedy}" for finding in applied
    )
    return Score(
        first,
        bool(names & set(fault.causes)),
        set(fault.rivals) <= names,
        bool(applied) and not wrong,
        f"{', '.join(wrong)} after: {stated}" if wrong else "",
        "-" if top is None else f"{top.cause} ({top.channel})",
        "-" if top is None else top.severity,
    )


def interval(right: int, count: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a share."""
    if count == 0:
        return 0.0, 1.0
    bounds = binomtest(right, count).proportion_ci(method="wilson")
    return float(bounds.low), float(bounds.high)


def share(right: int, count: int) -> str:
    """A share with its interval, in per cent."""
    low, high = interval(right, count)
    return "-" if count == 0 else f"{100 * right / count:.0f} % ({100 * low:.0f} to {100 * high:.0f})"
