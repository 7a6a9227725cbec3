"""Channels that were computed from others: they look like measurements and hold nothing new."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.statistics import longest_piece, robust_fit, sampling_period
from diffdrive.logs.log import Log, Signal

# Relative difference up to which two channels are one computation: rounding of text with seven digits, no noise.
COMPUTED = 1e-6


def _is_copy(signal: Signal, other: Signal) -> bool:
    std = float(np.std(other))
    return std > 0 and float(np.max(np.abs(signal - other))) <= COMPUTED * std


def copies(log: Log) -> Iterator[Finding]:
    """Position that is the reference, motor position that is the position."""
    if log.reference is not None and _is_copy(log.position, log.reference):
        yield Finding(
            "fatal",
            "position",
            "the tracking error is zero throughout: position and reference are one signal",
            "one of them is a copy: log the measured position and the set-point",
            "duplicate",
        )
    if log.motor_position is not None and _is_copy(log.motor_position, log.position):
        yield Finding(
            "warning",
            "motor_position",
            "the motor position is a copy of the position",
            "leave it out: it would prove that there is neither backlash nor wind-up",
            "duplicate",
        )


def velocity(log: Log) -> Iterator[Finding]:
    """Velocity that is a difference quotient of the position."""
    if log.velocity is None:
        return
    piece, period = longest_piece(log), sampling_period(log)
    position, measured = log.position[piece], log.velocity[piece]
    backward = np.diff(position, prepend=position[0]) / period
    quotients = {
        "backward difference": backward,
        "forward difference": np.append(backward[1:], 0.0),
        "central difference": np.gradient(position, period),
    }
    for name, quotient in quotients.items():
        # the time step may be that of rounded stamps: compare up to a factor near 1
        if np.std(quotient) > 0 and np.std(measured) > 0:
            ratio = float(np.dot(measured, quotient) / np.dot(quotient, quotient))
            if abs(ratio - 1) < 1e-3 and _is_copy(measured[2:-2], ratio * quotient[2:-2]):
                yield Finding(
                    "note",
                    "velocity",
                    f"the velocity is the {name} of the position",
                    "it holds nothing that the position does not: do not count it as a second sensor",
                    "duplicate",
                )
                return


def load(log: Log) -> Iterator[Finding]:
    """Load that is computed from the command."""
    if log.load is None or np.std(log.load) == 0 or np.std(log.command) == 0:
        return
    fit = robust_fit([log.command], log.load)
    if fit.error < 1e-4:
        gain, offset = (float(coefficient) for coefficient in fit.coefficients)
        yield Finding(
            "warning",
            "load",
            f"the load is {gain:.4g} times the command plus {offset:.4g} N: it was computed, not measured",
            "leave it out: friction fitted against it would explain the command by itself",
            "duplicate",
        )


def feedforward(log: Log) -> Iterator[Finding]:
    """Command that is a function of the reference alone, without any feedback in it."""
    if log.reference is None or np.std(log.command) == 0 or np.std(log.reference) == 0:
        return
    piece, period = longest_piece(log), sampling_period(log)
    reference = log.reference[piece]
    speed = np.gradient(reference, period)
    acceleration = np.gradient(speed, period)
    columns = [reference, speed, acceleration, np.sign(np.where(np.abs(speed) > 1e-9, speed, 0.0))]
    fit = robust_fit([column for column in columns if np.std(column) > 0], log.command[piece])
    # what a noisy, sticking axis makes its controller ask for is never a function of the reference to 0.01 %
    if fit.error < 1e-4:
        yield Finding(
            "warning",
            "command",
            f"the command follows from the reference alone to {100 * fit.error:.2g} %: it is a feed-forward, without "
            "the feedback",
            "log the whole command, feedback included",
            "feedforward only",
        )
