"""Logs as a command takes them: read through the drive file's mapping, at its rate, and looked over before use."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log, read_logs
from diffdrive.logs.checks.finding import SEVERITIES, Finding
from diffdrive.logs.mapping import ColumnMapping, log_and_channel, matches_log
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.motion.text import number
from experiments.reports.page.log_rows import log_rows
from experiments.reports.report import Report
from tuning.checked_logs import CheckedLogs, check_logs, require_sound, which_log, with_load

EXTRA = ("velocity", "current", "temperature")  # what neither identification nor diagnosis looks at


def axis_with_overrides(
    drive: Path, columns: Sequence[str], units: Sequence[str], shifts: Sequence[str], logs: Sequence[Path]
) -> Axis:
    """A drive file, its mapping of columns, units and shifts as texts on the command line override it.

    Raises `ParameterError` for a shift of none of the `logs`; one that the drive file has is of another day.
    """
    description = read_axis(drive)
    for text in shifts:
        log, _ = log_and_channel(text.rpartition("=")[0])
        if not any(matches_log(log, one) for one in logs):
            raise ParameterError(f"--shift {text}: no such log; the logs are {', '.join(one.name for one in logs)}")
    return replace(description, mapping=mapping_with_options(description.mapping, columns, units, shifts))


def mapping_with_options(
    mapping: ColumnMapping, columns: Sequence[str] = (), units: Sequence[str] = (), shifts: Sequence[str] = ()
) -> ColumnMapping:
    """The mapping with `--column reference=qg`, `--unit command=V` and `--shift command=-1` over its own."""
    new_shifts = {key: _samples(key, text) for key, text in assignments(shifts, "--shift").items()}
    return mapping.overridden(assignments(columns, "--column"), assignments(units, "--unit"), new_shifts)


_EXAMPLE_OF = {"--column": "reference=qg", "--unit": "command=V", "--shift": "command=-1"}


def assignments(texts: Sequence[str], option: str) -> dict[str, str]:
    """Values by channel from `CHANNEL=VALUE`."""
    values: dict[str, str] = {}
    for text in texts:
        # at the sign that is no part of a log's name, or of a unit or a column
        parts = text.rpartition("=") if option == "--shift" else text.partition("=")
        channel, equals, value = (part.strip() for part in parts)
        if not (channel and equals and value):
            raise LogError(f"{option} {text}: write CHANNEL=VALUE, such as {_EXAMPLE_OF[option]}")
        if channel in values:
            raise LogError(f"{option} {text}: {channel} is given twice")
        values[channel] = value
    return values


def _samples(channel: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise LogError(f"--shift {channel}={text}: write a whole number of samples, such as {channel}=-1") from None


def read_and_check(
    paths: Sequence[Path],
    description: Axis,
    report: Report,
    *,
    name: str,
    loads: Mapping[Path, float] | None = None,
    used: Sequence[str] = (),
    beside: Sequence[Log] = (),
) -> CheckedLogs:
    """Read logs, and say what the reader repaired and what is implausible (the table `name`), by the log's name.

    `loads` (N) by file: what was on the table where no column says it. `used` are channels of `EXTRA` that are
    looked at after all; `beside` are logs that were read before. Raises `LogError` for a log at another rate than the
    drive file's, one too short to be used and one that is given twice.
    """
    with report.working(f"reading and checking {', '.join(path.name for path in paths)}"):
        read = zip(paths, read_logs(paths, description), strict=True)
        logs = [with_load(log, (loads or {}).get(path)) for path, log in read]
        checked = check_logs(description, logs, files=paths, checked_before=beside)
        if report.out is not None:
            report.page.logs += log_rows(logs, paths)
    found = list(checked.findings)
    for log in logs:
        for note in log.notes:
            report.say(f"{log.name}: {note}")
        unused = [channel for channel in EXTRA if channel not in used and getattr(log, channel) is not None]
        if unused:
            report.say(f"{log.name}: {', '.join(unused)}: read and checked, but not used.")
    list_findings(report, name, logs, found)
    return checked


def list_findings(report: Report, name: str, logs: Sequence[Log], found: Sequence[tuple[str, Finding]]) -> None:
    """Findings, the gravest first; a table of sentences would break them into columns of a few words."""
    if not found:
        return
    report.record(
        name,
        ("log", "severity", "channel", "what", "remedy"),
        [[log, one.severity, one.channel, one.message, one.remedy] for log, one in found],
    )
    report.print(f"\nFindings in {', '.join(log.name for log in logs)}", style="bold")
    for log, one in sorted(found, key=lambda item: SEVERITIES.index(item[1].severity)):
        severity = one.severity.upper() if one.severity == "fatal" else one.severity
        report.print(f"- {severity}: {log}, {one.channel}: {one.message}")
        report.print(f"  Remedy: {one.remedy}")
    report.print("")


def read_sound_logs(
    paths: Sequence[Path],
    description: Axis,
    report: Report,
    *,
    name: str,
    force: bool,
    loads: Mapping[Path, float] | None = None,
    beside: Sequence[Log] = (),
) -> CheckedLogs:
    """Logs that were `read_and_check`; raises `LogError` for a fatal finding, too, unless it is to go on by `force`."""
    checked = read_and_check(paths, description, report, name=name, loads=loads, beside=beside)
    if not force:
        require_sound(checked, "--force identifies all the same, and fits that as mass or friction")
    if checked.fatal:
        report.say("Fatal findings are overruled by --force: where they are right, what follows is wrong.")
    return checked


def parse_loads(texts: Sequence[str], paths: Sequence[Path], sheet: DataSheet = NO_SHEET) -> dict[Path, float]:
    """Loads (N) by file from `LOG=FORCE`; raises `ParameterError` for a log that is not there, or named twice."""
    loads: dict[Path, float] = {}
    for text in texts:
        name, equals, force = text.rpartition("=")
        if not equals:
            raise ParameterError(f"--load {text}: write LOG=FORCE, such as {paths[0].name}=8kN")
        path = paths[which_log(name.strip(), paths, f"--load {text}")]
        if path in loads:
            raise ParameterError(f"--load {text}: {path} is given two loads")
        loads[path] = number(force.strip(), "N", f"--load {text}", sheet)
    return loads
