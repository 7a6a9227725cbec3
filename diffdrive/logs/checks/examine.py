"""Find the traps that real logs hold, before anything is identified from them: docs/method/log-checks.md lists them."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from diffdrive.axis import Axis
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

__all__ = ["Finding", "examine", "examine_together"]


def examine(log: Log, description: Axis | None = None) -> list[Finding]:
    """What is wrong with a log, or could mislead who uses it, the worst first.

    Without a drive description the command's unit, its timing, the count grid and the clock's rate remain unchecked.
    An identification should refuse a log with a `fatal` finding. A finding has a `repair` only where its cause is
    certain and the mended log shows nothing else.
    """
    findings = _unreadable_findings(log)
    if not findings:
        findings = _all_findings(log, description)
        findings = _verify_repairs(findings, log, description)
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def examine_together(logs: Sequence[Log], description: Axis | None = None) -> list[Finding]:
    """Where several logs of one machine contradict one another: none if each asks for the same mass and friction."""
    readable = [log for log in logs if not _unreadable_findings(log)]
    return [*together.contradictions(readable, description)]


def _unreadable_findings(log: Log) -> list[Finding]:
    """What forbids any further look."""
    findings = [*outliers.lengths(log)] or [*outliers.finite(log)]
    return findings or [*clock.order(log)]


def _all_findings(log: Log, description: Axis | None) -> list[Finding]:
    """All findings of a readable log: of the log without its overflows, where there are any."""
    resolution = None if description is None else description.drive.sensor.resolution
    overflows = [*wraps.wrapped_positions(log, resolution), *wraps.wrapped_command(log)]
    return [*overflows, *_findings_but_overflows(_repaired(log, overflows), description)]


def _repaired(log: Log, findings: list[Finding]) -> Log:
    """The log after all repairs that the findings state."""
    return Repair(tuple(step for one in findings if one.repair is not None for step in one.repair.steps)).apply(log)


def _findings_but_overflows(log: Log, description: Axis | None) -> list[Finding]:
    """All findings but overflows; what is said of the command comes first, since it has looked at all channels."""
    clocks = [*clock.rate(log, description)] if description is not None else []
    # a channel that stands still where it should move spoils every comparison with the others
    frozen = any(one.channel in ("reference", "position") for one in stuck.frozen_position(log))
    related, given = ([], None) if frozen else _check_command(log, description)
    steps = tuple(step for one in related if one.repair is not None for step in one.repair.steps)
    single = _single_channel_findings(log, description, None if steps else given)
    if steps:  # what goes with the fault that all channels show together is part of it; the rest counts in true units
        shown = {(one.cause, one.channel) for one in single}
        single = [
            one
            for one in _single_channel_findings(Repair(steps).apply(log), description, given)
            if (one.cause, one.channel) in shown
        ]
    return [*clocks, *related, *(_qualify_limit(one, related) for one in single if not _is_covered(one, related))]


def _qualify_limit(finding: Finding, related: list[Finding]) -> Finding:
    """What is said of the command's limit, where its unit may be another one than the limit's."""
    unsure = any(one.cause == "gain" and one.repair is None and one.channel == finding.channel for one in related)
    if (finding.cause, finding.channel) != ("clipped", "command") or not unsure:
        return finding
    return replace(
        finding,
        remedy="settle the unit of the command first; then this is actuator.force_limit, or the recorder's range ends",
    )


def _single_channel_findings(log: Log, description: Axis | None, given: Signal | None) -> list[Finding]:
    """What single channels show, or two by their ratio; `given` is the controller's own command, where it is known."""
    return [*_position_unit_findings(log, description), *_other_findings(log, description, given)]


def _is_covered(finding: Finding, related: list[Finding]) -> bool:
    """Whether what one channel shows by itself is part of what all show together, and no mended log can tell.

    Where there is a mended log, it has told already: this is for what cannot be undone, or has rivals.
    """
    lengths = {"position", "reference"}
    return any(
        one.repair is None
        and one.severity != "note"
        and one.cause == finding.cause
        and (finding.channel == one.channel or {finding.channel, one.channel} <= lengths)
        for one in related
    )


def _verify_repairs(findings: list[Finding], log: Log, description: Axis | None) -> list[Finding]:
    """The findings, each without its repair if the mended log shows anything that the log does not."""
    if all(one.repair is None for one in findings):
        return findings
    left = [one for one in _all_findings(_repaired(log, findings), description) if one.severity != "note"]
    # the log as it was given, its overflows included: what only an unwrapped channel shows speaks against them
    overflows = [one for one in findings if one.cause == "wrapped"]
    given = [*overflows, *_findings_but_overflows(log, description)] if overflows else findings
    return [finding if finding.repair is None else _drop_refuted_repair(finding, given, left) for finding in findings]


def _drop_refuted_repair(finding: Finding, given: list[Finding], left: list[Finding]) -> Finding:
    """The finding, without its repair if what is `left` in the mended log speaks against it.

    What the log as it was given shows as well is no rival; but if it is fatal, this mend alone makes no sound log. What
    is milder than before, or no worse than a warning, may stay.
    """
    worst = {(one.cause, one.channel): SEVERITIES.index(one.severity) for one in reversed(given)}
    same = (finding.cause, finding.channel)
    unchanged, new = [], []
    for one in left:
        before, now = worst.get((one.cause, one.channel), len(SEVERITIES)), SEVERITIES.index(one.severity)
        if now < before or (now == before and (one.cause, one.channel) == same):
            new.append(one)
        elif now == before and one.severity == "fatal":
            unchanged.append(one)
    if new:
        return replace(
            finding,
            remedy=f"{finding.remedy}; but the log so mended is not sound ({_listing(new)}), so the cause is not "
            "certain",
            rivals=(*finding.rivals, *dict.fromkeys(one.cause for one in new)),
            repair=None,
        )
    if unchanged:
        return replace(finding, remedy=f"{finding.remedy}; besides, {_listing(unchanged)}", repair=None)
    return finding


def _listing(findings: list[Finding]) -> str:
    return "; ".join(f"{one.channel}: {one.message}" for one in findings[:2])


def _position_unit_findings(log: Log, description: Axis | None) -> list[Finding]:
    """Unit and sign of reference and position, from their range, their ratio and their counts."""
    return [
        *ranges.travel(log, description),
        *ratios.position_follows_reference(log),
        *grid.position_grid(log, description),
    ]


def _other_findings(log: Log, description: Axis | None, given: Signal | None) -> list[Finding]:
    """What single channels show besides; `given` is the controller's own command, where it is known."""
    checks: list[Iterable[Finding]] = [
        clock.gaps(log),
        clock.stamps(log),
        outliers.spikes(log, given),
        outliers.lost_rows(log),
        bursts.unexplained(log, description, given),
        encoders.lost_motion(log, description),
        ranges.load(log, description),
        ranges.temperature(log),
        ratios.zeros(log),
        ratios.motor_follows_position(log),
        ratios.velocity_is_derivative(log),
        grid.command_grid(log),
        stuck.constant(log),
        clipping.clipped_command(log, description, given),
        stuck.frozen_position(log),
        stuck.frozen_command(log),
        derived.copies(log),
        derived.velocity(log),
        derived.load(log),
        derived.feedforward(log),
        motion.variety(log),
        motion.begins_in_motion(log),
    ]
    return [finding for check in checks for finding in check]


def _check_command(log: Log, description: Axis | None) -> command.CommandCheck:
    """The command against the controller, or where that does not answer, against the balance of forces."""
    if np.ptp(log.command) == 0 or np.ptp(log.position) == 0:
        return command.CommandCheck([])
    if description is None:
        return command.CommandCheck([*balance.command_sign(log)])
    return command.check_command(log, description)
