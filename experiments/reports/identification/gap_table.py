"""The table of how far a drive is from its logs, before and after identification."""

from collections.abc import Sequence
from dataclasses import replace

from diffdrive.axis import Axis
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from experiments.reports.report import Report
from tuning.identification.gaps import MEASURES, delay_of
from tuning.identification.replay import drift_note

NOTABLY = 1.01  # times a gap, from which another is larger
GapRow = tuple[str, str, str, float, float]  # log, its role, the gap, the drive file's and the identified drive's


def _larger(rows: Sequence[GapRow]) -> list[str]:
    """Why a gap is larger with the identified drive, where one is."""
    larger = [f"{log}, {gap.rpartition(',')[0]}" for log, _, gap, was, now in rows if now > NOTABLY * was]
    if not larger:
        return []
    return [
        f"Larger with the identified drive: {'; '.join(dict.fromkeys(larger))}. The search minimises the one-step "
        "prediction of the logs that it is given, weighted by its noise; in closed and in open loop, and on other "
        "logs, what the model lacks may weigh otherwise, and where both drives are at the noise their order is chance."
    ]


def gap_table(
    report: Report,
    description: Axis,
    identified: Drive,
    delay: float,
    logs: Sequence[Log],
    held_out: Sequence[Log],
) -> None:
    """Print each measure on each log for the drive file's drive and for the `identified` one; nothing is refitted.

    The controller is the drive file's in both cases, with the model that it had when the logs were made.
    """
    rows: list[GapRow] = []
    with report.working("the gap before and after"):
        for role, several in (("identified from", logs), ("held out", held_out)):
            for log in several:
                for measure in MEASURES:
                    was = measure(description, delay_of(description.drive), log)
                    now = measure(replace(description, drive=identified), delay, log)
                    rows += [(log.name, role, name, was[name], now[name]) for name in was]
    report.table(
        "gaps",
        ("log", "role", "gap", "drive file", "identified"),
        rows,
        "The gap to the logs, RMS",
        notes=_larger(rows),
    )
    note = drift_note(identified)
    report.say(f"{note[0].upper()}{note[1:]}.")
