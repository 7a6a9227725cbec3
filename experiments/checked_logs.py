"""Logs as a command takes them: read through the drive file's mapping, at its rate, and looked over before use."""

from collections.abc import Sequence
from pathlib import Path

from diffdrive.drive_file import DriveDescription
from diffdrive.errors import LogError
from diffdrive.logs import Log, read_logs
from diffdrive.logs.plausibility import examine
from experiments.report import Report

RATE_TOLERANCE = 1e-3  # clocks drift by less, and what is more is another rate


def read_checked(
    paths: Sequence[Path], description: DriveDescription, report: Report, *, name: str, force: bool
) -> tuple[Log, ...]:
    """Read logs, say what the reader repaired and what is implausible (the table `name`), and refuse what is fatal.

    Raises `LogError` for a log at another rate than the drive file's and, without `force`, for a fatal finding.
    """
    with report.working(f"reading and checking {', '.join(path.name for path in paths)}"):
        logs = read_logs(paths, description.mapping, description.sampling.rate)
        for path, log in zip(paths, logs, strict=True):
            _require_rate(path, log, description.sampling.rate)
        found = [(log.name, finding) for log in logs for finding in examine(log, description)]
    for log in logs:
        for note in log.notes:
            report.say(f"{log.name}: {note}")
    if found:
        report.table(
            name,
            ("log", "severity", "channel", "what", "mend"),
            [[log, one.severity, one.channel, one.found, one.mend] for log, one in found],
            f"What {', '.join(log.name for log in logs)} would mislead about, or limits",
        )
    fatal = [(log, one) for log, one in found if one.severity == "fatal"]
    if fatal and not force:
        log, one = fatal[0]
        raise LogError(
            f"{log}: {one.channel}: {one.found}; {one.mend} (--force identifies all the same, and fits that as mass or "
            "friction)"
        )
    if fatal:
        report.say("FORCED over fatal findings: what follows is wrong as far as they are right.")
    return logs


def _require_rate(path: Path, log: Log, rate: float) -> None:
    if abs(log.rate / rate - 1) > RATE_TOLERANCE:
        raise LogError(
            f"{path}: is sampled at {log.rate:g} Hz, the drive file's controller runs at {rate:g} Hz: log every sample "
            "of the controller, or set [sampling] rate to that at which it ran"
        )
