"""Bursts of the command that do not move the table: forces that were logged, but never acted."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from diffdrive.axis import Axis
from diffdrive.logs.checks.dynamics import inverse_dynamics
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.grid import noise_std
from diffdrive.logs.checks.statistics import longest_piece, robust_std, sampling_period
from diffdrive.logs.log import Log, Signal

WINDOW = 0.2  # s: what is usual is that of the samples around
WINDOW_OF_REST = 2.0  # s: what a controller with states leaves of the command changes slowly
UNUSUAL_STDS = 12.0  # standard deviations of the samples around; a reversal's jerk reaches 10
LARGE = 0.1  # of the command's range
EDGE = 1  # samples within which a burst begins and ends
SHORTEST = 3  # samples: fewer are outliers
IGNORED = 0.25  # share of the motion that the burst alone makes, below which it did not act
MOVED = 5.0  # noises of the position that a burst must have moved the table by, had it acted


class Burst(NamedTuple):
    """A stretch of samples [start, stop), and the force (N) that it adds to what is usual around."""

    start: int
    stop: int
    force: float


def find_bursts(command: Signal, period: float, window: float = WINDOW) -> list[Burst]:
    """Stretches of the command far from what the samples before and after, over `window` (s), make likely."""
    length = max(5, 2 * int(window / period / 2) + 1)
    if len(command) < 3 * length:
        return []
    residual = command - _running_median(command, length)
    local_std = np.maximum(_running_median(np.abs(residual), length) * 1.4826, 0.02 * robust_std(command))
    is_unusual = (np.abs(residual) > UNUSUAL_STDS * local_std) & (np.abs(residual) > LARGE * float(np.ptp(command)))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], is_unusual.astype(int), [0]])))
    found = [Burst(int(a), int(b), float(np.mean(residual[a:b]))) for a, b in edges.reshape(-1, 2)]
    found = [burst for burst in found if SHORTEST <= burst.stop - burst.start < length]
    return [
        burst
        for burst in found
        if _is_switched(command, burst.start, burst) and _is_switched(command, burst.stop, burst)
    ]


def _is_switched(command: Signal, edge: int, burst: Burst) -> bool:
    """Whether the command jumps by the burst within two samples of `edge`: friction makes no such jumps."""
    samples = command[max(0, edge - EDGE - 1) : edge + EDGE + 1]
    return float(np.max(np.abs(np.diff(samples)), initial=0.0)) > 0.5 * abs(burst.force)


def _running_median(signal: Signal, length: int) -> Signal:
    """Running median over `length` samples, from fifty of them."""
    stride = max(1, length // 50)
    medians = median_filter(signal[::stride], size=max(5, length // stride), mode="nearest")
    return np.interp(np.arange(len(signal)), np.arange(len(signal))[::stride], medians)


def unexplained(log: Log, axis: Axis | None, controller_command: Signal | None = None) -> Iterator[Finding]:
    """Bursts beyond `controller_command`, where that is known, else those that do not move the table."""
    piece, period = longest_piece(log), sampling_period(log)
    position, command = log.position[piece], log.command[piece]
    if controller_command is None:
        found = find_bursts(command, period)
    else:
        found = find_bursts(command - controller_command[piece], period, min(WINDOW_OF_REST, len(command) * period / 4))
        found = [burst for burst in found if abs(burst.force) > LARGE * float(np.ptp(command))]
    mass = _mass(position, command, period, axis)
    ignored = [] if mass is None else [burst for burst in found if _is_ignored(burst, position, period, mass)]
    if controller_command is None:
        found, description = ignored, "to which the table does not react: this force never acted"
    else:
        description = "which the controller did not give: test pulses, or the logger's"
        if ignored:
            description = (
                f"which the controller did not give; to {len(ignored)} of them the table does not react: it never acted"
            )
    if not found:
        return
    largest = max(found, key=lambda burst: abs(burst.force))
    start = log.time[piece.start + largest.start]
    yield Finding(
        "warning",
        "command",
        f"{len(found)} bursts of up to {largest.force:.4g} N, the largest at t = {start:.6g} s for "
        f"{1e3 * (largest.stop - largest.start) * period:.3g} ms, {description}",
        "cut these stretches out and list the gaps, or log the command that reached the amplifier",
        "burst",
    )


def _is_ignored(burst: Burst, position: Signal, period: float, mass: float) -> bool:
    """Whether a table of this mass (kg) would have moved visibly under the burst, and did not."""
    length = burst.stop - burst.start
    # what the impulse alone does within its own length and as long after
    expected = 1.5 * burst.force / mass * (length * period) ** 2
    after, before = min(burst.stop + length, len(position) - 1), max(burst.start - 2 * length, 0)
    rows = np.arange(before, burst.start + 1)
    line = np.polynomial.Polynomial.fit(rows, position[before : burst.start + 1], 1)
    displacement = float(position[after] - line(after))
    return abs(expected) > MOVED * noise_std(position) and abs(displacement / expected) < IGNORED


def _mass(position: Signal, command: Signal, period: float, axis: Axis | None) -> float | None:
    if axis is not None:
        return float(axis.drive.plant.mass)
    dynamics = inverse_dynamics(position, command, period)
    return dynamics.mass.value if dynamics is not None and dynamics.mass.value > 2 * dynamics.mass.std else None
