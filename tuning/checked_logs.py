"""Logs as identification and diagnosis take them: at the axis's rate, long enough, each once, and looked over."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.axis import Axis
from diffdrive.errors import LogError
from diffdrive.logs import Log, read_log
from diffdrive.logs.checks.examine import Finding, examine, examine_together
from diffdrive.logs.clocks.rate import RATE_TOLERANCE
from tuning.identification.problem import MIN_LANE_SAMPLES


@dataclass(frozen=True)
class CheckedLogs:
    """Logs, and what the checks found in them: the log's name (or how many logs together), and the finding."""

    logs: tuple[Log, ...]
    findings: tuple[tuple[str, Finding], ...]

    @property
    def fatal(self) -> list[tuple[str, Finding]]:
        """The findings over which nothing should go on."""
        return [(log, one) for log, one in self.findings if one.severity == "fatal"]

    @property
    def worth_saying(self) -> list[tuple[str, Finding]]:
        """The findings that are more than notes."""
        return [(log, one) for log, one in self.findings if one.severity != "note"]


def as_logs(axis: Axis, sources: Any) -> tuple[Log, ...]:
    """One or several logs: as they are, or read with the axis's columns and units. Raises `LogError`."""
    several = sources if isinstance(sources, list | tuple) else [sources]
    if not several:
        raise LogError("no log is given; give one or more")
    return tuple(one if isinstance(one, Log) else read_log(one, axis) for one in several)


def check_logs(
    axis: Axis,
    logs: Sequence[Log],
    *,
    files: Sequence[Path] | None = None,
    loads: Mapping[str, float] | None = None,
    beside: Sequence[Log] = (),
) -> CheckedLogs:
    """Look logs over before they are used: what in them would mislead.

    `files` are where they are from, if they are, for messages; `loads` (N), by log or file name, what was on the table
    where the log does not say it; `beside` are logs that were looked over before, of the same machine. Raises
    `LogError` for a log at another rate than the axis's, one too short to be used, and one that is given twice.
    """
    where = [log.name for log in logs] if files is None else [str(file) for file in files]
    known = [log.name for log in logs] if files is None else [file.name for file in files]
    for place, log in zip(where, logs, strict=True):
        _require_rate(place, log, axis.rate)
        _require_length(place, log)
    _require_different(where, logs, beside, None if files is None else [file.resolve() for file in files])
    logs = tuple(_with_load(log, (loads or {}).get(name)) for name, log in zip(known, logs, strict=True))
    found = [(log.name, finding) for log in logs for finding in examine(log, axis)]
    found += [(f"{len(beside) + len(logs)} logs", one) for one in examine_together([*beside, *logs], axis)]
    return CheckedLogs(logs, tuple(found))


def require_sound(checked: CheckedLogs, mend: str) -> None:
    """Raise `LogError` for the first fatal finding; `mend` says how to go on all the same."""
    if checked.fatal:
        log, one = checked.fatal[0]
        raise LogError(f"{log}: {one.channel}: {one.message}; {one.remedy} ({mend})")


def _with_load(log: Log, load: float | None) -> Log:
    if load is None:
        return log
    if log.load is not None:
        raise LogError(
            f"{log.name}: has a load of its own, in its column 'load': leave out --load, or map it elsewhere"
        )
    return replace(log, load=np.full(len(log.time), load))


def _require_rate(path: str, log: Log, rate: float) -> None:
    if abs(log.rate / rate - 1) > RATE_TOLERANCE:
        raise LogError(
            f"{path}: is sampled at {log.rate:g} Hz, the drive file's controller runs at {rate:g} Hz: log every sample "
            "of the controller, or set [sampling] rate to that at which it ran"
        )


def _require_length(path: str, log: Log) -> None:
    longest = max(piece.stop - piece.start for piece in log.pieces())
    if longest < MIN_LANE_SAMPLES:
        raise LogError(
            f"{path}: has at most {longest} samples in a row without a gap; at least {MIN_LANE_SAMPLES} are needed, "
            f"{MIN_LANE_SAMPLES / log.rate:.3g} s at {log.rate:g} Hz, and some seconds to learn from: log a longer "
            "motion"
        )


def _require_different(
    paths: Sequence[str], logs: Sequence[Log], beside: Sequence[Log], files: Sequence[Path] | None
) -> None:
    """A log that is given twice counts its noise twice, and held out it proves nothing."""
    for k, (path, log) in enumerate(zip(paths, logs, strict=True)):
        if files is not None and files[k] in files[:k]:
            raise LogError(f"{path}: is given twice; give each log once")
        same = next((other.name for other in [*beside, *logs[:k]] if _same_samples(log, other)), None)
        if same is not None:
            raise LogError(
                f"{path}: holds the same samples as {same}; give each log once, and hold out one of another run"
            )


def _same_samples(one: Log, other: Log) -> bool:
    return np.array_equal(one.position, other.position) and np.array_equal(one.command, other.command)
