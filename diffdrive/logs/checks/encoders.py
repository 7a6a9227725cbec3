"""Two encoders of one axis: whether the difference of motor and table depends on the direction of motion."""

from collections.abc import Iterator

import numpy as np

from diffdrive.axis import Axis
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import noise_std
from diffdrive.logs.checks.ratios import motor_follows_position
from diffdrive.logs.checks.statistics import derivative, longest_piece, robust_fit, sampling_period
from diffdrive.logs.log import Log

SLIDING = 0.1  # share of the top speed above which the direction is clear
# Wind-up of a screw under friction alone is some micrometres: 100 N on 50 N/um are 2 um, either way.
WIND_UP = 5e-6


def lost_motion(log: Log, axis: Axis | None) -> Iterator[Finding]:
    """Motor minus table while it moves forwards against while it moves backwards: play, or wind-up under friction."""
    if log.motor_position is None or any(motor_follows_position(log)):  # in one unit first
        return
    piece, period = longest_piece(log), sampling_period(log)
    motor, table = log.motor_position[piece], log.position[piece]
    speed = derivative(table, period, 1)
    moving = np.abs(speed) > SLIDING * float(np.quantile(np.abs(speed), 0.999))
    forwards = moving & (speed > 0)
    if min(int(np.sum(forwards)), int(np.sum(moving & ~forwards))) < 50:
        return
    force = derivative(log.command[piece], period, 0)
    columns = [np.sign(speed)[moving], table[moving] - table.mean(), force[moving]]
    fit = robust_fit([column for column in columns if np.std(column) > 0], (motor - table)[moving])
    reversal_error = 2.0 * float(fit.coefficients[0])
    difference = float(np.median((motor - table)[forwards]) - np.median((motor - table)[moving & ~forwards]))
    noise = np.hypot(noise_std(motor), noise_std(table))
    if abs(difference) < max(WIND_UP, 10 * noise):
        return
    residual_std = 1.4826 * float(np.median(np.abs(fit.residual)))
    play = reversal_error if np.sign(reversal_error) == np.sign(difference) else difference
    yield Finding(
        "warning",
        "motor_position",
        f"motor and table are {1e6 * difference:.3g} um apart between the two directions, {1e6 * play:.3g} um of it "
        f"whatever the force (scatter {1e6 * residual_std:.2g} um): lost motion",
        "backlash of screw, nut or coupling, or wind-up under friction: state it in the drive file as "
        "[effects.backlash] or [effects.compliance], or let a diagnosis find it; identify with the encoder that the "
        "controller uses",
        "lost motion",
    )
