"""What this motion can teach: notes for an identification, not faults of the log."""

from collections.abc import Iterator

import numpy as np

from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import noise_std
from diffdrive.logs.checks.statistics import derivative, longest_piece, sampling_period
from diffdrive.logs.log import Log

SHORT = 1.0  # s of motion: fewer strokes than that hold no more than a handful of reversals
STROKES = 20  # counts: a travel below is noise


def variety(log: Log) -> Iterator[Finding]:
    """Motion at all, long enough, both ways, at several speeds."""
    piece, period, noise_level = longest_piece(log), sampling_period(log), noise_std(log.position[longest_piece(log)])
    position = log.position[piece]
    speed = derivative(position, period, 1)
    top_speed = float(np.quantile(np.abs(speed), 0.999))
    if np.ptp(position) < max(STROKES * noise_level, 1e-9) or np.ptp(position) == 0:
        yield Finding(
            "note",
            "position",
            f"the table rests throughout: it travels {np.ptp(position):.3g} m, its noise is {noise_level:.2g} m",
            "friction at speed, mass and damping cannot be learnt from it: log a motion",
            "motion",
        )
        return
    moving = np.abs(speed) > 0.05 * top_speed
    duration = float(np.sum(moving)) * period
    if duration < SHORT:
        yield Finding(
            "note",
            "position",
            f"the table moves for {duration:.3g} s only",
            "log several strokes, some seconds in all",
            "motion",
        )
    forwards = float(np.mean(speed[moving] > 0))
    if not 0.02 < forwards < 0.98:
        direction = "positive" if forwards > 0.5 else "negative"
        yield Finding(
            "note",
            "position",
            f"the table moves in the {direction} direction only ({100 * max(forwards, 1 - forwards):.0f} % of its "
            "motion)",
            "a constant force and the friction of the other direction cannot be separated: log both",
            "motion",
        )
    speeds = np.quantile(np.abs(speed[np.abs(speed) > 0.2 * top_speed]), [0.1, 0.9])
    if speeds[1] < 1.5 * speeds[0]:
        yield Finding(
            "note",
            "position",
            f"the table moves at one speed ({speeds[0]:.4g} to {speeds[1]:.4g} m/s most of the time)",
            "Coulomb and viscous friction cannot be separated at one speed: log several",
            "motion",
        )


def speed_at(log: Log, first: int = 0) -> float:
    """Speed (m/s) at sample `first`; 0 where the table may rest."""
    period, longest = sampling_period(log), log.position[longest_piece(log)]
    top_speed = float(np.quantile(np.abs(derivative(longest, period, 1)), 0.999))
    position = log.position[first:]
    count = max(2, min(len(position) - 1, int(2e-3 / period)))  # 2 ms: an axis gains 10 mm/s in it at 5 m/s^2
    speed = float(position[count] - position[0]) / (count * period)
    uncertainty = np.sqrt(2) * noise_std(longest) / (count * period)
    return speed if abs(speed) > max(0.01 * top_speed, 5 * uncertainty) else 0.0


def begins_in_motion(log: Log) -> Iterator[Finding]:
    """A log whose first sample is not at rest."""
    speed = speed_at(log)
    if speed:
        lag_text = ""
        if log.reference is not None:
            lag_text = f" and {1e3 * (log.reference[0] - log.position[0]):.3g} mm behind its reference"
        yield Finding(
            "note",
            "position",
            f"the log begins in motion, at {1e3 * speed:.3g} mm/s{lag_text}",
            "begin a simulation in that state (position, speed, controller's past), not at rest on the reference",
            "motion",
        )
