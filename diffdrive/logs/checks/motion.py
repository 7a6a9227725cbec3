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
    piece, step, noise = longest_piece(log), sampling_period(log), noise_std(log.position[longest_piece(log)])
    position = log.position[piece]
    speed = derivative(position, step, 1)
    top = float(np.quantile(np.abs(speed), 0.999))
    if np.ptp(position) < max(STROKES * noise, 1e-9) or np.ptp(position) == 0:
        yield Finding(
            "note",
            "position",
            f"the table rests throughout: it travels {np.ptp(position):.3g} m, its noise is {noise:.2g} m",
            "friction at speed, mass and damping cannot be learnt from it: log a motion",
            "motion",
        )
        return
    moving = np.abs(speed) > 0.05 * top
    time = float(np.sum(moving)) * step
    if time < SHORT:
        yield Finding(
            "note",
            "position",
            f"the table moves for {time:.3g} s only",
            "log several strokes, some seconds in all",
            "motion",
        )
    positive = float(np.mean(speed[moving] > 0))
    if not 0.02 < positive < 0.98:
        way = "positive" if positive > 0.5 else "negative"
        yield Finding(
            "note",
            "position",
            f"the table moves in the {way} direction only ({100 * max(positive, 1 - positive):.0f} % of its motion)",
            "a constant force and the friction of the other direction cannot be told from it: log both",
            "motion",
        )
    levels = np.quantile(np.abs(speed[np.abs(speed) > 0.2 * top]), [0.1, 0.9])
    if levels[1] < 1.5 * levels[0]:
        yield Finding(
            "note",
            "position",
            f"the table moves at one speed ({levels[0]:.4g} to {levels[1]:.4g} m/s most of the time)",
            "Coulomb and viscous friction cannot be told apart at one speed: log several",
            "motion",
        )


def speed_at(log: Log, first: int = 0) -> float:
    """Speed (m/s) at sample `first`; 0 where the table may rest."""
    step, longest = sampling_period(log), log.position[longest_piece(log)]
    top = float(np.quantile(np.abs(derivative(longest, step, 1)), 0.999))
    position = log.position[first:]
    count = max(2, min(len(position) - 1, int(2e-3 / step)))  # 2 ms: an axis gains 10 mm/s in it at 5 m/s^2
    speed = float(position[count] - position[0]) / (count * step)
    doubt = np.sqrt(2) * noise_std(longest) / (count * step)
    return speed if abs(speed) > max(0.01 * top, 5 * doubt) else 0.0


def begins_in_motion(log: Log) -> Iterator[Finding]:
    """A log whose first sample is not at rest."""
    speed = speed_at(log)
    if speed:
        behind = ""
        if log.reference is not None:
            behind = f" and {1e3 * (log.reference[0] - log.position[0]):.3g} mm behind its reference"
        yield Finding(
            "note",
            "position",
            f"the log begins in motion, at {1e3 * speed:.3g} mm/s{behind}",
            "begin a simulation in that state (position, speed, controller's past), not at rest on the reference",
            "motion",
        )
