"""`diffdrive check`: what logs hold, what was repaired when they were read, and what they would mislead about."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis
from diffdrive.errors import LogError
from diffdrive.logs.checks.encoders import compared
from diffdrive.logs.log import CHANNELS, Log
from experiments.reports.checked_logs import EXTRA, axis_with_overrides, parse_loads, read_and_check
from experiments.reports.controller import report_controller
from experiments.reports.encoders import report_encoders
from experiments.reports.readable import titled
from experiments.reports.report import Report
from tuning.identification.controller.workflow import identify_controller
from tuning.identification.excitation import shortcomings
from tuning.identification.shown_motion import ExcitationDeficit

SMOOTH = 5e-3  # s, over which a speed is taken


def check_logs(
    paths: Sequence[Path],
    drive: Path,
    out: Path | None,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    shifts: Sequence[str] = (),
    loads: Sequence[str] = (),
    controller: bool = False,
) -> bool:
    """Whether nothing fatal was found in any log.

    `columns`, `units`, `shifts` and `loads` are texts as on the command line. With `controller`, the gains of the
    cascade that made the commands are printed, too. Raises `DriveFileError`, `LogError` and
    `ParameterError`, one line each.
    """
    description = axis_with_overrides(drive, columns, units, shifts, paths)
    with Report(f"{drive.name}: a look at {', '.join(path.name for path in paths)}", out) as report:
        with report.result_first() as result:
            checked = read_and_check(
                paths,
                description,
                report,
                name="findings",
                loads=parse_loads(loads, list(paths), description.sheet),
                used=EXTRA,
            )
            found, fatal = checked.findings, checked.fatal
            report.keep("verdict", fatal=len(fatal), findings=len(found))
            result(findings_in_words(len(found), len(fatal)))
            report.conclude(good=not fatal)
        names = ("log", "samples", "rate Hz", "s", "gaps", "from mm", "to mm", "fastest mm/s", "largest N", "channels")
        rows = [_row(log) for log in checked.logs]
        report.record("logs", names, rows)
        headings = (*names[:3], "length, s", *names[4:8], "largest command N", names[9])
        report.show("What the logs hold", headings, rows, of="logs")
        if not fatal:
            for lack in _shortcomings(checked.logs, description):
                report.say(f"{titled(lack.sentence)}.")
        comparisons = [compared(log, description) for log in checked.logs]
        report_encoders(report, [one for one in comparisons if one is not None])
        if controller:
            with report.working("fitting the controller"):
                estimate = identify_controller(description, list(checked.logs))
            report_controller(report, estimate)
    return not fatal


def _shortcomings(logs: Sequence[Log], axis: Axis) -> list[ExcitationDeficit]:
    """What all these logs together do not determine of the drive; nothing where that cannot be judged."""
    try:
        return shortcomings(logs, axis.as_logged().drive)
    except LogError:
        return []


def findings_in_words(findings: int, fatal: int) -> str:
    """The verdict of a check."""
    if not findings:
        return "No findings: the checks found nothing wrong with the logs."
    if findings == 1:
        wrong = "correct the log first; what is fitted to it would be wrong."
        return f"1 finding, fatal: {wrong}" if fatal else "1 finding, not fatal: the log can be used."
    if fatal:
        wrong = "correct the logs first; what is fitted to them would be wrong."
        return f"{findings} findings, {fatal} of them fatal: {wrong}"
    return f"{findings} findings, none of them fatal: the logs can be used."


def _row(log: Log) -> list[object]:
    few = max(1, round(SMOOTH * log.rate))
    speeds = [np.abs(log.position[piece][few:] - log.position[piece][:-few]) * log.rate / few for piece in log.pieces()]
    fastest = max((float(np.max(one)) for one in speeds if one.size), default=0.0)
    there = [name for name in CHANNELS if name != "time" and getattr(log, name) is not None]
    ends = 1e3 * float(np.nanmin(log.position)), 1e3 * float(np.nanmax(log.position))
    largest = float(np.nanmax(np.abs(log.command)))
    seconds = len(log.time) / log.rate
    return [
        log.name, len(log.time), log.rate, seconds, len(log.gaps), *ends, 1e3 * fastest, largest, " ".join(there)
    ]  # fmt: skip
