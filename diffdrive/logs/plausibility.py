"""Find the traps that real logs hold, before anything is identified from them: docs/log-checks.md lists them."""

from collections.abc import Iterable

import numpy as np

from diffdrive.controllers import UnknownController
from diffdrive.drive_file import DriveDescription
from diffdrive.logs.checks import (
    balance,
    clock,
    comparison,
    controller,
    derived,
    grid,
    motion,
    outliers,
    ranges,
    ratios,
    stuck,
)
from diffdrive.logs.checks.finding import SEVERITIES, Finding
from diffdrive.logs.log import Log

__all__ = ["Finding", "examine"]


def examine(log: Log, description: DriveDescription | None = None) -> list[Finding]:
    """What is wrong with a log, or could mislead who uses it, the worst first.

    Without a drive description the command's unit, its timing, the count grid and the clock's rate remain unchecked.
    An identification should refuse a log with a `fatal` finding.
    """
    findings = _readable(log)
    if not findings:
        units = _position_unit(log, description)
        findings = [*units, *_signals(log, description)]
        if all(finding.severity == "note" for finding in units):  # with a wrong position any command looks wrong
            findings += _command(log, description)
    return sorted(findings, key=lambda finding: SEVERITIES.index(finding.severity))


def _readable(log: Log) -> list[Finding]:
    """What forbids any further look."""
    findings = [*outliers.lengths(log)] or [*outliers.finite(log)]
    return findings or [*clock.order(log)]


def _position_unit(log: Log, description: DriveDescription | None) -> list[Finding]:
    """Unit and sign of reference and position, from their range, their ratio and their counts."""
    counts = [*grid.position_grid(log, description)]
    return [
        *ranges.travel(log, description),
        *ratios.position_follows_reference(log),
        *(finding for finding in counts if finding.severity == "fatal"),
    ]


def _signals(log: Log, description: DriveDescription | None) -> list[Finding]:
    """Everything that needs no controller."""
    checks: list[Iterable[Finding]] = [
        clock.gaps(log),
        clock.stamps(log),
        clock.rate(log, description) if description is not None else [],
        outliers.spikes(log),
        outliers.lost_rows(log),
        ranges.load(log, description),
        ranges.temperature(log),
        ratios.motor_follows_position(log),
        ratios.velocity_is_derivative(log),
        (finding for finding in grid.position_grid(log, description) if finding.severity != "fatal"),
        grid.command_grid(log),
        stuck.constant(log),
        stuck.clipped_command(log, description),
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


def _command(log: Log, description: DriveDescription | None) -> list[Finding]:
    """The command against the controller, or where that does not answer, against the balance of forces."""
    if np.ptp(log.command) == 0 or np.ptp(log.position) == 0:
        return []
    if description is None:
        return [*balance.command_opposes_friction(log)]
    unknown = isinstance(description.controller, UnknownController)
    found = None if unknown else comparison.compare(log, description)
    if found is not None and found.related:
        return [
            *controller.timing(log, found, description),
            *controller.unit_and_sign(log, found, description),
            *controller.disturbance(log, found),
            *controller.added(found),
            *controller.explained(found, description),
        ]
    reversed_command = [*balance.command_opposes_friction(log)]
    unexplained = [] if found is None else [*controller.explained(found, description)]
    return [*unexplained, *(reversed_command or balance.command_unit(log, description))]
