"""Logs as a command takes them: read through the drive file's mapping, at its rate, and looked over before use."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_drive
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log, read_logs
from diffdrive.logs.checks.examine import Finding, examine, examine_together
from diffdrive.logs.clocks.rate import RATE_TOLERANCE
from diffdrive.logs.mapping import log_and_channel, means
from diffdrive.motion.text import number
from experiments.reports.report import Report
from tuning.identification.problem import SHORTEST

EXTRA = ("motor_position", "velocity", "current", "temperature")  # what identification does not look at


def described(
    drive: Path, columns: Sequence[str], units: Sequence[str], shifts: Sequence[str], logs: Sequence[Path]
) -> Axis:
    """A drive file, its mapping of columns, units and shifts as texts on the command line override it.

    Raises `ParameterError` for a shift of none of the `logs`; one that the drive file has is of another day.
    """
    description = read_drive(drive)
    for text in shifts:
        log, _ = log_and_channel(text.rpartition("=")[0])
        if not any(means(log, one) for one in logs):
            raise ParameterError(f"--shift {text}: no such log; the logs are {', '.join(one.name for one in logs)}")
    return replace(description, mapping=description.mapping.overridden(columns, units, shifts))


def looked_over(
    paths: Sequence[Path],
    description: Axis,
    report: Report,
    *,
    name: str,
    loads: Mapping[str, float] | None = None,
    used: Sequence[str] = (),
    beside: Sequence[Log] = (),
) -> tuple[tuple[Log, ...], list[tuple[str, Finding]]]:
    """Read logs, and say what the reader repaired and what is implausible (the table `name`), by the log's name.

    `loads` (N) by file name: what was on the table where no column says it. `used` are channels of `EXTRA` that are
    looked at after all; `beside` are logs that were read before. Raises `LogError` for a log at another rate than the
    drive file's, one too short to be used and one that is given twice.
    """
    with report.working(f"reading and checking {', '.join(path.name for path in paths)}"):
        logs = read_logs(paths, mapping=description.mapping, rate=description.sampling.rate)
        for path, log in zip(paths, logs, strict=True):
            _require_rate(path, log, description.sampling.rate)
            _require_length(path, log)
        _require_different(paths, logs, beside)
        logs = tuple(_under(log, (loads or {}).get(path.name)) for path, log in zip(paths, logs, strict=True))
        found = [(log.name, finding) for log in logs for finding in examine(log, description)]
        together = examine_together([*beside, *logs], description)
        found += [(f"{len(beside) + len(logs)} logs", finding) for finding in together]
    for log in logs:
        for note in log.notes:
            report.say(f"{log.name}: {note}")
        unused = [channel for channel in EXTRA if channel not in used and getattr(log, channel) is not None]
        if unused:
            report.say(f"{log.name}: {', '.join(unused)}: read and checked, but not used.")
    if found:
        report.table(
            name,
            ("log", "severity", "channel", "what", "mend"),
            [[log, one.severity, one.channel, one.found, one.mend] for log, one in found],
            f"What {', '.join(log.name for log in logs)} would mislead about, or limits",
        )
    return logs, found


def fatal_of(found: Sequence[tuple[str, Finding]]) -> list[tuple[str, Finding]]:
    """The findings over which nothing should go on."""
    return [(log, one) for log, one in found if one.severity == "fatal"]


def read_checked(
    paths: Sequence[Path],
    description: Axis,
    report: Report,
    *,
    name: str,
    force: bool,
    loads: Mapping[str, float] | None = None,
    beside: Sequence[Log] = (),
) -> tuple[Log, ...]:
    """Logs that were `looked_over`; raises `LogError` for a fatal finding, too, unless it is to go on by `force`."""
    logs, found = looked_over(paths, description, report, name=name, loads=loads, beside=beside)
    fatal = fatal_of(found)
    if fatal and not force:
        log, one = fatal[0]
        raise LogError(
            f"{log}: {one.channel}: {one.found}; {one.mend} (--force identifies all the same, and fits that as mass or "
            "friction)"
        )
    if fatal:
        report.say("FORCED over fatal findings: what follows is wrong as far as they are right.")
    return logs


def parse_loads(texts: Sequence[str], paths: Sequence[Path]) -> dict[str, float]:
    """Loads (N) by file name from `LOG=FORCE`; raises `ParameterError` for a log that is not there, or named twice."""
    names = [path.name for path in paths]
    loads: dict[str, float] = {}
    for text in texts:
        name, equals, force = text.rpartition("=")
        name = Path(name.strip()).name
        if not equals or name not in names:
            raise ParameterError(
                f"--load {text}: write LOG=FORCE, such as {names[0]}=8kN; the logs are {', '.join(names)}"
            )
        if name in loads or names.count(name) > 1:
            raise ParameterError(f"--load {text}: {name} is not one log, or is named twice")
        loads[name] = number(force.strip(), "N", f"--load {text}")
    return loads


def _under(log: Log, load: float | None) -> Log:
    if load is None:
        return log
    if log.load is not None:
        raise LogError(
            f"{log.name}: has a load of its own, in its column 'load': leave out --load, or map it elsewhere"
        )
    return replace(log, load=np.full(len(log.time), load))


def _require_rate(path: Path, log: Log, rate: float) -> None:
    if abs(log.rate / rate - 1) > RATE_TOLERANCE:
        raise LogError(
            f"{path}: is sampled at {log.rate:g} Hz, the drive file's controller runs at {rate:g} Hz: log every sample "
            "of the controller, or set [sampling] rate to that at which it ran"
        )


def _require_length(path: Path, log: Log) -> None:
    longest = max(piece.stop - piece.start for piece in log.pieces())
    if longest < SHORTEST:
        raise LogError(
            f"{path}: has at most {longest} samples in a row without a gap; at least {SHORTEST} are needed, "
            f"{SHORTEST / log.rate:.3g} s at {log.rate:g} Hz, and some seconds to learn from: log a longer motion"
        )


def _require_different(paths: Sequence[Path], logs: Sequence[Log], beside: Sequence[Log]) -> None:
    """A log that is given twice counts its noise twice, and held out it proves nothing."""
    for k, (path, log) in enumerate(zip(paths, logs, strict=True)):
        if path.resolve() in [other.resolve() for other in paths[:k]]:
            raise LogError(f"{path}: is given twice; give each log once")
        same = next((other.name for other in [*beside, *logs[:k]] if _same_samples(log, other)), None)
        if same is not None:
            raise LogError(
                f"{path}: holds the same samples as {same}; give each log once, and hold out one of another run"
            )


def _same_samples(one: Log, other: Log) -> bool:
    return np.array_equal(one.position, other.position) and np.array_equal(one.command, other.command)
