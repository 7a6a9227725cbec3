"""What the log does not rule out beside its best explanation, in words and as causes."""

from collections.abc import Callable, Sequence

from diffdrive.logs.checks.explanation import ChannelFault, LogExplanation, are_equivalent
from diffdrive.logs.checks.finding import CAUSES


def causes_of(best: LogExplanation, rivals: Sequence[LogExplanation]) -> tuple[str, ...]:
    """The causes of the rivals: those that the best explanation does not name, or of which it names another amount."""
    causes = []
    for rival in rivals:
        other_causes = sorted(rival.causes - best.causes)
        if other_causes:
            causes += [cause for cause, _ in other_causes]
        elif rival.causes == best.causes:
            causes += [fault.cause for fault in _faults_of_other_size(best, rival)]
        else:
            causes += [] if rival.faults else ["nothing"]
    return tuple(dict.fromkeys(causes))


def rivals_text(
    best: LogExplanation,
    rivals: Sequence[LogExplanation],
    remedy_of: Callable[[ChannelFault], str],
    nothing: str = "nothing at all",
) -> str:
    """The rivals as the end of a sentence, empty where there are none; `remedy_of` gives the remedy of a fault.

    `nothing` stands for the rival that the log has no fault.
    """
    others = sorted({pair for rival in rivals for pair in rival.causes - best.causes})
    amounts = [fault for rival in rivals if rival.causes == best.causes for fault in _faults_of_other_size(best, rival)]
    fewer = [rival for rival in rivals if rival.causes < best.causes]
    parts = [f"{channel}: {CAUSES[cause]}" for cause, channel in others]
    parts += [f"another amount ({remedy_of(fault)})" for fault in amounts]
    parts += [
        "only " + " and ".join(f"{on}: {CAUSES[cause]}" for cause, on in rival.causes)
        for rival in fewer
        if rival.faults
    ]
    parts += [nothing] if any(not rival.faults for rival in fewer) else []
    return "; the log does not rule out: " + "; or ".join(parts) if parts else ""


def _faults_of_other_size(best: LogExplanation, rival: LogExplanation) -> list[ChannelFault]:
    return [
        fault
        for fault in rival.faults
        if not any(are_equivalent(fault.steps, other.steps) for other in best.faults if other.cause == fault.cause)
    ]
