"""The table of how far a drive is from its logs, before and after identification."""

from collections.abc import Sequence

from experiments.reports.report import Report
from tuning.identification.gaps import Gap
from tuning.identification.replay import drift_note
from tuning.identification.workflow import IdentificationResult

NOTABLY = 1.01  # times a gap, from which another is larger


def gap_table(report: Report, result: IdentificationResult) -> None:
    """Print each measure on each log, before and after."""
    with report.working("the gap before and after"):
        found = result.gaps
    report.table(
        "gaps",
        ("log", "role", "measure", "drive file", "identified"),
        [list(gap) for gap in found],
        "Model against logs, RMS",
        notes=[*_of_noise(found), *_larger(found)],
    )
    note = drift_note(result.axis.drive)
    report.say(f"{note[0].upper()}{note[1:]}.")


def _of_noise(found: Sequence[Gap]) -> list[str]:
    """What measures of the command in closed loop hold beside the model's error."""
    if not any(gap.measure.startswith("closed loop: command") for gap in found):
        return []
    return ["Scale noise alone may make most of a closed-loop command difference; `diagnose` prints this floor."]


def _larger(found: Sequence[Gap]) -> list[str]:
    """Why a difference is larger with the identified drive, where one is."""
    larger = [f"{gap.log}, {gap.measure.rpartition(',')[0]}" for gap in found if gap.after > NOTABLY * gap.before]
    if not larger:
        return []
    return [
        f"Larger with the identified drive: {'; '.join(dict.fromkeys(larger))}. The search minimises the one-step "
        "prediction of the logs that it is given, weighted by its noise; in closed and in open loop, and on other "
        "logs, the missing effect may weigh otherwise, and where both drives are at the noise their order is chance."
    ]
