"""What the checks say of a log whose fault is known, and whether that is right."""

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
    rivals: bool  # so are those that nobody can rule out
    repaired: bool  # a repair was stated, and right
    wrong_repair: str
    summary: str  # of the first finding
    severity: str


def first_finding(findings: Sequence[Finding]) -> Finding | None:
    """The finding that a user reads first: the first that is more than a note, else the first note."""
    return next((one for one in findings if one.severity != "note"), findings[0] if findings else None)


def apply_repairs(
    log: Log, description: Axis, examine: Examine, findings: Sequence[Finding]
) -> tuple[Log, list[Finding]]:
    """The log after the mends that a user would apply, and the findings that stated them."""
    applied: list[Finding] = []
    while len(applied) < MAX_REPAIRS:
        one = next((one for one in findings if one.repair is not None), None)
        if one is None or one.repair is None:
            break
        log = one.repair.apply(log)
        applied.append(one)
        findings = examine(log, description)
    return log, applied


def score_fault(fault: LogFault, description: Axis, resolution: float, examine: Examine) -> Score:
    """Examine a log with a fault, and compare with the truth."""
    findings = examine(fault.log, description)
    top = first_finding(findings)
    first = top is not None and top.cause in fault.causes and (not fault.channels or top.channel in fault.channels)
    # every note has a cause of its own; what only confirms is no hypothesis
    names = {name for one in findings for name in (one.cause, *one.rivals)}
    log, applied = apply_repairs(fault.log, description, examine, findings)
    wrong = differences(log, fault, resolution) if applied else []
    told = "; ".join(f"{one.severity}: {one.channel}: {one.message}; {one.remedy}" for one in applied)
    return Score(
        first,
        bool(names & set(fault.causes)),
        set(fault.rivals) <= names,
        bool(applied) and not wrong,
        f"{', '.join(wrong)} after: {told}" if wrong else "",
        "-" if top is None else f"{top.cause} ({top.channel})",
        "-" if top is None else top.severity,
    )


def interval(right: int, count: int) -> tuple[float, float]:
    """The 95 % Wilson interval of a share."""
    if count == 0:
        return 0.0, 1.0
    found = binomtest(right, count).proportion_ci(method="wilson")
    return float(found.low), float(found.high)


def share(right: int, count: int) -> str:
    """A share with its interval, in per cent."""
    low, high = interval(right, count)
    return "-" if count == 0 else f"{100 * right / count:.0f} % ({100 * low:.0f} to {100 * high:.0f})"
