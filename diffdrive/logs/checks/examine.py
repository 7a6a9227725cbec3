"""Find the traps that real logs hold, before anything is identified from them: docs/method/log-checks.md lists them."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.logs.checks import (
    balance,
    bursts,
    clipping,
    clock,
    command,
    derived,
    encoders,
    grid,
    motion,
    outliers,
    ranges,
    ratios,
    stuck,
    together,
    wraps,
)
from diffdrive.logs.checks.finding import SEVERITIES, Finding
from diffdrive.logs.checks.repair import Repair
from diffdrive.logs.log import Log, Signal
from diffdrive.support.messages import short_repr
from diffdrive.support.registry import Registry

__all__ = ["Finding", "examine", "examine_together", "register_check"]

Check = Callable[[Log, Axis | None], Iterable[Finding]]

_REGISTERED: Registry[Check] = Registry("check of logs")


def register_check(check: Check) -> Check:
    """Make a check of one's own known to `examine`, and so to `check`, `identify` and `diagnose`: a decorator.

    The function gets a readable `Log` in SI units and the `Axis`, None where no drive file is given, and yields a
    `Finding` for each trap that it sees. A check is known by its module and name, and replaced by one of the same.
    Raises `ParameterError` for what has no name: a lambda, or a `partial`.

    Examples:
        >>> @register_check
        ... def short(log, axis):
        ...     if log.duration < 1.0:
        ...         yield Finding("note", "time", f"the log lasts {log.duration:.2g} s", "record a lap", "motion")

    """
    name = getattr(check, "__qualname__", "")
    if not name or name.endswith("<lambda>"):
        raise ParameterError(f"check of logs {short_repr(check)}: must be a function with a name: `def` it")
    _REGISTERED.add(f"{check.__module__}.{name}", check)
    return check


def examine(log: Log, axis: Axis | None = None) -> list[Finding]:
    """What is wrong with a log, or could mislead its user, the worst first.

    Without an `axis` the command's unit, its timing, the count grid and the clock's rate remain unchecked.
    An identification should refuse a log with a `fatal` finding. A finding has a `repair` only where its cause is
    certain and the repaired log shows nothing else.
    """
    findings = _unreadable_findings(log)
    if not findings:
        seen = None if axis is None else axis.as_logged()
        findings = _all_findings(log, seen)
        findings = [*_verify_repairs(findings, log, seen), *_of_trace(axis)]
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def examine_together(logs: Sequence[Log], axis: Axis | None = None) -> list[Finding]:
    """Where several logs of one machine contradict one another: none if each implies the same mass and friction."""
    readable = [log for log in logs if not _unreadable_findings(log)]
    return [*together.contradictions(readable, None if axis is None else axis.as_logged())]


def _of_trace(axis: Axis | None) -> Iterator[Finding]:
    """What cannot be said of the logs of this axis, by the trace that its file states."""
    if axis is not None and axis.unseen_controller:
        yield Finding(
            "note",
            "command",
            f"{axis.unseen_controller}: what the controller made of this log is not computed again",
            "no action needed: mass, friction and effects are found from the command as it is logged",
            "trace",
        )


def _unreadable_findings(log: Log) -> list[Finding]:
    """Findings that rule out any further check."""
    findings = [*outliers.lengths(log)] or [*outliers.finite(log)]
    return findings or [*clock.order(log)]


def _all_findings(log: Log, axis: Axis | None) -> list[Finding]:
    """All findings of a readable log: of the log without its overflows, where there are any."""
    resolution = None if axis is None else axis.drive.sensor.resolution
    count = None if resolution is None else float(resolution)
    overflows = [*wraps.wrapped_positions(log, count), *wraps.wrapped_command(log)]
    return [*overflows, *_findings_but_overflows(_repaired(log, overflows), axis)]


def _repaired(log: Log, findings: list[Finding]) -> Log:
    """The log after all repairs that the findings state."""
    return Repair(
        tuple(step for finding in findings if finding.repair is not None for step in finding.repair.steps)
    ).apply(log)


def _findings_but_overflows(log: Log, axis: Axis | None) -> list[Finding]:
    """All findings but overflows; those of the command come first, since they rest on all channels."""
    clock_findings = [*clock.rate(log, axis)] if axis is not None else []
    # a channel that stands still where it should move spoils every comparison with the others
    is_frozen = any(finding.channel in ("reference", "position") for finding in stuck.frozen_position(log))
    command_findings, controller_command = ([], None) if is_frozen else _check_command(log, axis)
    steps = tuple(step for finding in command_findings if finding.repair is not None for step in finding.repair.steps)
    single = _single_channel_findings(log, axis, None if steps else controller_command)
    if steps:  # what goes with the fault that all channels show together is part of it; the rest counts in true units
        causes = {(finding.cause, finding.channel) for finding in single}
        single = [
            finding
            for finding in _single_channel_findings(Repair(steps).apply(log), axis, controller_command)
            if (finding.cause, finding.channel) in causes
        ]
    return [
        *clock_findings,
        *command_findings,
        *(
            _qualify_limit(finding, command_findings)
            for finding in single
            if not _is_covered(finding, command_findings)
        ),
    ]


def _qualify_limit(finding: Finding, command_findings: list[Finding]) -> Finding:
    """The finding on the command's limit, with a remedy that does not assume its unit where that is uncertain."""
    is_unit_uncertain = any(
        other.cause == "gain" and other.repair is None and other.channel == finding.channel
        for other in command_findings
    )
    if (finding.cause, finding.channel) != ("clipped", "command") or not is_unit_uncertain:
        return finding
    return replace(
        finding,
        remedy="settle the unit of the command first; then this is actuator.force_limit, or the recorder's range ends",
    )


def _single_channel_findings(log: Log, axis: Axis | None, controller_command: Signal | None) -> list[Finding]:
    """Findings of single channels, or of two by their ratio; `controller_command` [n] (N) where it is known."""
    return [*_position_unit_findings(log, axis), *_other_findings(log, axis, controller_command)]


def _is_covered(finding: Finding, command_findings: list[Finding]) -> bool:
    """Whether a finding of one channel is part of one of all channels, where there is no repaired log to decide.

    Where there is a repaired log, it has decided: this is for what cannot be undone, or has rivals.
    """
    lengths = {"position", "reference"}
    return any(
        other.repair is None
        and other.severity != "note"
        and other.cause == finding.cause
        and (finding.channel == other.channel or {finding.channel, other.channel} <= lengths)
        for other in command_findings
    )


def _verify_repairs(findings: list[Finding], log: Log, axis: Axis | None) -> list[Finding]:
    """The findings, each without its repair if the repaired log shows anything that the log does not."""
    if all(finding.repair is None for finding in findings):
        return findings
    after_repair = [finding for finding in _all_findings(_repaired(log, findings), axis) if finding.severity != "note"]
    # the log as it was read, its overflows included: what only an unwrapped channel shows speaks against them
    overflows = [finding for finding in findings if finding.cause == "wrapped"]
    before_repair = [*overflows, *_findings_but_overflows(log, axis)] if overflows else findings
    return [
        finding if finding.repair is None else _drop_refuted_repair(finding, before_repair, after_repair)
        for finding in findings
    ]


def _drop_refuted_repair(finding: Finding, before: list[Finding], after: list[Finding]) -> Finding:
    """The finding, without its repair if the findings `after` it speak against it.

    What the log shows before the repair as well is no rival; but if it is fatal, this repair alone makes no sound log.
    What is milder than before, or no worse than a warning, may stay.
    """
    worst_before = {(other.cause, other.channel): SEVERITIES.index(other.severity) for other in reversed(before)}
    key = (finding.cause, finding.channel)
    unchanged, new = [], []
    for other in after:
        severity_before = worst_before.get((other.cause, other.channel), len(SEVERITIES))
        severity_now = SEVERITIES.index(other.severity)
        if severity_now < severity_before or (severity_now == severity_before and (other.cause, other.channel) == key):
            new.append(other)
        elif severity_now == severity_before and other.severity == "fatal":
            unchanged.append(other)
    if new:
        return replace(
            finding,
            remedy=f"{finding.remedy}; but the log repaired so has other faults ({_listing(new)}), so the cause is not "
            "certain",
            rivals=(*finding.rivals, *dict.fromkeys(other.cause for other in new)),
            repair=None,
        )
    if unchanged:
        return replace(finding, remedy=f"{finding.remedy}; besides, {_listing(unchanged)}", repair=None)
    return finding


def _listing(findings: list[Finding]) -> str:
    return "; ".join(f"{finding.channel}: {finding.message}" for finding in findings[:2])


def _position_unit_findings(log: Log, axis: Axis | None) -> list[Finding]:
    """Unit and sign of reference and position, from their range, their ratio and their counts."""
    return [
        *ranges.travel(log, axis),
        *ratios.position_follows_reference(log),
        *grid.position_grid(log, axis),
    ]


def _other_findings(log: Log, axis: Axis | None, controller_command: Signal | None) -> list[Finding]:
    """Other findings of single channels; `controller_command` [n] (N) where it is known."""
    checks: list[Iterable[Finding]] = [
        clock.gaps(log),
        clock.stamps(log),
        outliers.spikes(log, controller_command),
        outliers.lost_rows(log),
        bursts.unexplained(log, axis, controller_command),
        encoders.two_encoders(log, axis),
        ranges.load(log, axis),
        ranges.temperature(log),
        ratios.zeros(log),
        ratios.motor_follows_position(log),
        ratios.velocity_is_derivative(log),
        grid.command_grid(log),
        stuck.constant(log),
        clipping.clipped_command(log, axis, controller_command),
        stuck.frozen_position(log),
        stuck.frozen_command(log),
        derived.copies(log),
        derived.velocity(log),
        derived.load(log),
        derived.feedforward(log),
        motion.variety(log),
        motion.begins_in_motion(log),
        *(check(log, axis) for check in _REGISTERED.values()),
    ]
    return [finding for check in checks for finding in check]


def _check_command(log: Log, axis: Axis | None) -> command.CommandCheck:
    """The command against the controller, or where that does not answer, against the balance of forces."""
    if np.ptp(log.command) == 0 or np.ptp(log.position) == 0:
        return command.CommandCheck([])
    if axis is None:
        return command.CommandCheck([*balance.command_sign(log)])
    return command.check_command(log, axis)
