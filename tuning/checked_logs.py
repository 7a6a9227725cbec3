"""Logs as identification and diagnosis take them: at the trace's rate, long enough, each once, and looked over."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from diffdrive.axis import Axis, require_axis
from diffdrive.errors import LogError, ParameterError
from diffdrive.logs import Log, read_logs
from diffdrive.logs.checks.examine import Finding, examine, examine_together
from diffdrive.logs.mapping import matches_log
from diffdrive.support.messages import suggestion
from diffdrive.support.rates import CLOCK_TOLERANCE, is_same_rate
from tuning.identification.controller.findings import controller_findings
from tuning.identification.problem import MIN_LANE_SAMPLES


@dataclass(frozen=True)
class CheckedLogs:
    """Logs, and what the checks found in them: the log's name (or how many logs together), and the finding."""

    logs: tuple[Log, ...]
    findings: tuple[tuple[str, Finding], ...]

    @property
    def fatal(self) -> list[tuple[str, Finding]]:
        """The findings over which nothing should go on."""
        return [(log, finding) for log, finding in self.findings if finding.severity == "fatal"]

    @property
    def notable(self) -> list[tuple[str, Finding]]:
        """The findings that are more than notes."""
        return [(log, finding) for log, finding in self.findings if finding.severity != "note"]


def checked(axis: Axis, *groups: object, loads: Mapping[str, float] | None = None) -> list[CheckedLogs]:
    """Each group of logs (`Log`, or what `read_logs` reads) looked over beside those before it.

    `CheckedLogs` are left as they are, None is no logs. `loads` (N), by keys as `which_log` takes them, are what was on
    the table where a log does not say it. Raises `LogError`, and `ParameterError` for a load of no log or of several.
    """
    found: list[CheckedLogs] = []
    for group, logs in zip(groups, _read_groups(axis, groups, loads), strict=True):
        if isinstance(group, CheckedLogs):
            found.append(group)
        elif logs:
            found.append(check_logs(axis, logs, checked_before=[log for one in found for log in one.logs]))
        else:
            found.append(CheckedLogs((), ()))
    return found


def checked_apart(axis: Axis, *groups: object, loads: Mapping[str, float] | None = None) -> list[CheckedLogs]:
    """`checked`, but each group looked over by itself: between two states of a machine a change is no contradiction."""
    return [
        group if isinstance(group, CheckedLogs) else check_logs(axis, logs) if logs else CheckedLogs((), ())
        for group, logs in zip(groups, _read_groups(axis, groups, loads), strict=True)
    ]


def _read_groups(axis: Axis, groups: Sequence[object], loads: Mapping[str, float] | None) -> list[list[Log]]:
    """The logs of each group with the loads that are given by log; none of one that was looked over, or is None."""
    require_axis(axis)
    read = [[] if group is None or isinstance(group, CheckedLogs) else _read(axis, group) for group in groups]
    paths = [path for group in read for path, _ in group]
    load_of: dict[int, float] = {}
    for key, load in (loads or {}).items():
        k = which_log(key, paths, f"loads: {key!r}")
        if k in load_of:
            raise ParameterError(f"loads: {key!r}: {paths[k]} is given two loads, under two names")
        load_of[k] = load
    with_loads, first = [], 0
    for named in read:
        with_loads.append([with_load(log, load_of.get(k)) for k, (_, log) in enumerate(named, start=first)])
        first += len(named)
    return with_loads


def which_log(key: str, paths: Sequence[Path], where: str) -> int:
    """Which log a key names: by its file, or by its name where it has no file, as the keys of [shifts] do.

    `where` begins the `ParameterError` for a key that names none of them, or several.
    """
    same = [k for k, path in enumerate(paths) if str(path) == key]
    named = same or [k for k, path in enumerate(paths) if key and matches_log(key, path)]
    if not named:
        raise ParameterError(f"{where}: no such log; {suggestion(key, [path.name for path in paths])}")
    if len(named) > 1:
        raise ParameterError(
            f"{where}: names {len(named)} logs, {', '.join(str(paths[k]) for k in named)}: write the folder, too, such "
            f"as monday/{paths[named[0]].name}, or read each log under a name of its own"
        )
    return named[0]


def _read(axis: Axis, sources: object) -> list[tuple[Path, Log]]:
    """One or several logs, each with its file, or its name where it has none."""
    listed = sources if isinstance(sources, list | tuple) else [sources]
    if not listed:
        raise LogError("no log is given; give one or more")
    unread = [source for source in listed if not isinstance(source, Log)]
    read = iter(read_logs(unread, axis) if unread else ())
    logs = [source if isinstance(source, Log) else next(read) for source in listed]
    return [
        (Path(source if isinstance(source, str | Path) else log.name), log)
        for source, log in zip(listed, logs, strict=True)
    ]


def check_logs(
    axis: Axis,
    logs: Sequence[Log],
    *,
    files: Sequence[Path] | None = None,
    checked_before: Sequence[Log] = (),
) -> CheckedLogs:
    """Look logs over before they are used: what in them would mislead.

    `files` are where they are from, if they are, for messages; `checked_before` are logs that were looked over before,
    of the same machine. Raises `LogError` for a log at another rate than the axis's trace, one that is too short
    to be used, and one that is given twice.
    """
    labels = [log.name for log in logs] if files is None else [str(file) for file in files]
    for place, log in zip(labels, logs, strict=True):
        _require_rate(place, log, axis)
        _require_length(place, log)
    require_different(labels, logs, checked_before, None if files is None else [file.resolve() for file in files])
    found = [(log.name, finding) for log in logs for finding in examine(log, axis)]
    found += [
        (f"{len(checked_before) + len(logs)} logs", finding)
        for finding in examine_together([*checked_before, *logs], axis)
    ]
    found += controller_findings(axis, logs, checked_before)
    return CheckedLogs(tuple(logs), tuple(found))


def require_sound(checked: CheckedLogs, remedy: str) -> None:
    """Raise `LogError` for the first fatal finding; `remedy` says how to go on all the same."""
    if checked.fatal:
        log, finding = checked.fatal[0]
        raise LogError(f"{log}: {finding.channel}: {finding.message}; {finding.remedy} ({remedy})")


def with_load(log: Log, load: float | None) -> Log:
    """The log with a constant load (N), or as it is; raises `LogError` where it has one of its own."""
    if load is None:
        return log
    if log.load is not None:
        raise LogError(
            f"{log.name}: has a load of its own, in its column 'load': state none for it, or map the column elsewhere"
        )
    return replace(log, load=np.full(len(log.time), load))


def _require_rate(path: str, log: Log, axis: Axis) -> None:
    if is_same_rate(log.rate, axis.log_rate, CLOCK_TOLERANCE):
        return
    if axis.trace.rate is not None:
        raise LogError(
            f"{path}: is sampled at {log.rate:g} Hz, [trace] rate of the drive file is {axis.log_rate:g} Hz: correct it"
        )
    raise LogError(
        f"{path}: is sampled at {log.rate:g} Hz, the drive file's controller runs at {axis.rate:g} Hz: log every "
        "sample of the controller; if that is what was logged, set [sampling] rate to the log's rate; if the trace "
        'cannot be faster, state [trace] rate, or, for an unknown controller, that [sampling] rate and kind = "unknown"'
    )


def _require_length(path: str, log: Log) -> None:
    longest = max(piece.stop - piece.start for piece in log.pieces())
    if longest < MIN_LANE_SAMPLES:
        raise LogError(
            f"{path}: has at most {longest} samples in a row without a gap; at least {MIN_LANE_SAMPLES} are needed, "
            f"{MIN_LANE_SAMPLES / log.rate:.3g} s at {log.rate:g} Hz, and some seconds to learn from: log a longer "
            "motion"
        )


def require_different(
    paths: Sequence[str], logs: Sequence[Log], checked_before: Sequence[Log], files: Sequence[Path] | None = None
) -> None:
    """Raise `LogError` for a log that is given twice: it counts its noise twice, and held out it proves nothing."""
    for k, (path, log) in enumerate(zip(paths, logs, strict=True)):
        if files is not None and files[k] in files[:k]:
            raise LogError(f"{path}: is given twice; give each log once")
        duplicate = next((other.name for other in [*checked_before, *logs[:k]] if _same_samples(log, other)), None)
        if duplicate is not None:
            raise LogError(
                f"{path}: holds the same samples as {duplicate}; give each log once, and hold out one of another run"
            )


def _same_samples(log: Log, other: Log) -> bool:
    return np.array_equal(log.position, other.position) and np.array_equal(log.command, other.command)
