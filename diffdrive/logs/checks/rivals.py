"""What the log does not rule out beside its best explanation, in words and as causes."""

from collections.abc import Callable, Sequence

from diffdrive.logs.checks.explanation import ChannelFault, LogExplanation, are_equivalent
from diffdrive.logs.checks.finding import CAUSES


def causes_of(best: LogExplanation, rivals: Sequence[LogExplanation]) -> tuple[str, ...]:
    """The causes of the rivals: those that the best explanation does not name, or of which it names another amount."""
    found = []
    for one in rivals:
        more = sorted(one.causes - best.causes)
        if more:
            found += [cause for cause, _ in more]
        elif one.causes == best.causes:
            found += [fault.cause for fault in _faults_of_other_size(best, one)]
        else:
            found += [] if one.faults else ["nothing"]
    return tuple(dict.fromkeys(found))


def rivals_text(
    best: LogExplanation,
    rivals: Sequence[LogExplanation],
    mend: Callable[[ChannelFault], str],
    nothing: str = "nothing at all",
) -> str:
    """The rivals as the end of a sentence, empty where there are none; `mend` says what undoes a fault.

    `nothing` is what else it is where the log is in order.
    """
    others = sorted({pair for one in rivals for pair in one.causes - best.causes})
    amounts = [fault for one in rivals if one.causes == best.causes for fault in _faults_of_other_size(best, one)]
    fewer = [one for one in rivals if one.causes < best.causes]
    parts = [f"{channel}: {CAUSES[cause]}" for cause, channel in others]
    parts += [f"another amount ({mend(fault)})" for fault in amounts]
    parts += [
        "only " + " and ".join(f"{on}: {CAUSES[cause]}" for cause, on in one.causes) for one in fewer if one.faults
    ]
    parts += [nothing] if any(not one.faults for one in fewer) else []
    return "; the log does not rule out: " + "; or ".join(parts) if parts else ""


def _faults_of_other_size(best: LogExplanation, rival: LogExplanation) -> list[ChannelFault]:
    return [
        fault
        for fault in rival.faults
        if not any(are_equivalent(fault.steps, one.steps) for one in best.faults if one.cause == fault.cause)
    ]
