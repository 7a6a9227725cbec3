"""Channels that must agree: position with reference, motor with table, velocity with the position's derivative."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.factors import unit_error_text
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.statistics import derivative, longest_piece, robust_fit, sampling_period
from diffdrive.logs.log import Log, Signal

# Correlation at which two signals are the same motion: a loop that lags by 8 degrees still reaches it.
SAME_MOTION = 0.99
# A loop at its bandwidth follows with 0.7 to 1.4 times the amplitude: beyond that a ratio is a unit, not a loop.
UNIT_ERROR = 1.5
# A weight on a loop without an integral leaves a constant error, but one of the size that friction makes as well.
BEYOND_FOLLOWING = 3.0
FEWEST = 50  # samples in either direction
# Kinematics (pitch error, growth of the screw) stay within 1e-3; a ratio off by this is a wrong lead or gear.
SCALE_ERROR = 0.03


def _compare(channel: str, other: str, signal: Signal, other_signal: Signal, trusted: bool) -> Iterator[Finding]:
    if np.std(signal) == 0 or np.std(other_signal) == 0:
        return
    fit = robust_fit([other_signal], signal)
    ratio, is_same_motion = float(fit.coefficients[0]), fit.error < np.sqrt(1 - SAME_MOTION**2)
    if not is_same_motion:
        correlation = float(np.corrcoef(signal, other_signal)[0, 1])
        if correlation < -0.7:
            yield Finding(
                "fatal",
                channel,
                f"the {channel} runs against the {other} (correlation {correlation:.2f}): its sign is reversed",
                f"reverse the {channel}, or the {other}",
                "reversed",
            )
        return
    if ratio < 0:
        yield Finding(
            "fatal",
            channel,
            f"the {channel} is {ratio:.4g} times the {other}: its sign is reversed"
            + (unit_error_text(ratio) if abs(ratio) > UNIT_ERROR or abs(ratio) < 1 / UNIT_ERROR else ""),
            f"reverse the {channel}, or the {other}",
            "reversed",
        )
    elif not 1 / UNIT_ERROR < ratio < UNIT_ERROR:
        yield Finding(
            "fatal",
            channel,
            f"the {channel} is {ratio:.4g} times the {other}{unit_error_text(ratio)}",
            f"correct the unit of the {channel}, or of the {other}",
            "gain",
        )
    elif abs(ratio - 1) > SCALE_ERROR and (trusted or fit.error < 0.03):
        yield Finding(
            "warning",
            channel,
            f"the {channel} is {ratio:.4g} times the {other}, which no loop and no kinematic error explains",
            "check the lead, the gear or the counts per turn behind either",
            "gain",
        )


def position_follows_reference(log: Log) -> Iterator[Finding]:
    """Position against reference: unit and sign."""
    if log.reference is not None:
        piece = longest_piece(log)
        yield from _compare("position", "reference", log.position[piece], log.reference[piece], False)


def zeros(log: Log) -> Iterator[Finding]:
    """A constant between reference and position that is beyond all that the loop makes of its motion."""
    if log.reference is None:
        return
    piece, period = longest_piece(log), sampling_period(log)
    speed = derivative(log.position[piece], period, 1)
    error = (log.reference - log.position)[piece]
    is_fast = np.abs(speed) > 0.1 * float(np.quantile(np.abs(speed), 0.999))
    if min(int(np.sum(is_fast & (speed > 0))), int(np.sum(is_fast & (speed < 0)))) < FEWEST:
        return  # what friction makes of the error has one sign then, too
    median = float(np.median(error))
    if abs(median) > BEYOND_FOLLOWING * float(np.quantile(np.abs(error - median), 0.99)):
        yield Finding(
            "warning",
            "reference",
            f"reference and position are {1e3 * median:.6g} mm apart throughout, far beyond the following error: their "
            "zeros differ",
            f"add {-1e3 * median:.6g} mm to the reference, as far as the loop leaves no such error under a weight",
            "offset",
        )


def motor_follows_position(log: Log) -> Iterator[Finding]:
    """Motor encoder against table scale: unit and sign."""
    if log.motor_position is not None:
        piece = longest_piece(log)
        yield from _compare("motor_position", "position", log.motor_position[piece], log.position[piece], True)


def velocity_is_derivative(log: Log) -> Iterator[Finding]:
    """Velocity against the slope of the position, both smoothed: unit and sign."""
    if log.velocity is not None:
        piece, period = longest_piece(log), sampling_period(log)
        slope = derivative(log.position[piece], period, 1)
        velocity = derivative(log.velocity[piece], period, 0)
        yield from _compare("velocity", "position's derivative", velocity, slope, False)
