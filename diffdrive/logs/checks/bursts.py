"""Bursts of the command that the table does not react to: forces that were logged, but never acted."""

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
WINDOW_OF_REST = 2.0  # s: what a controller leaves of the command changes as slowly as what it remembers
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


def find_bursts(command: Signal, step: float, window: float = WINDOW) -> list[Burst]:
    """Stretches of the command far from what the samples before and after, over `window` (s), make likely."""
    length = max(5, 2 * int(window / step / 2) + 1)
    if len(command) < 3 * length:
        return []
    rest = command - _running_median(command, length)
    around = np.maximum(_running_median(np.abs(rest), length) * 1.4826, 0.02 * robust_std(command))
    unusual = (np.abs(rest) > UNUSUAL_STDS * around) & (np.abs(rest) > LARGE * float(np.ptp(command)))
    edges = np.flatnonzero(np.diff(np.concatenate([[0], unusual.astype(int), [0]])))
    found = [Burst(int(a), int(b), float(np.mean(rest[a:b]))) for a, b in edges.reshape(-1, 2)]
    found = [one for one in found if SHORTEST <= one.stop - one.start < length]
    return [one for one in found if _is_switched(command, one.start, one) and _is_switched(command, one.stop, one)]


def _is_switched(command: Signal, at: int, burst: Burst) -> bool:
    """Whether the command jumps by the burst within two samples of `at`: forces that friction asks for do not."""
    around = command[max(0, at - EDGE - 1) : at + EDGE + 1]
    return float(np.max(np.abs(np.diff(around)), initial=0.0)) > 0.5 * abs(burst.force)


def _running_median(signal: Signal, length: int) -> Signal:
    """Running median over `length` samples, from fifty of them."""
    thin = max(1, length // 50)
    coarse = median_filter(signal[::thin], size=max(5, length // thin), mode="nearest")
    return np.interp(np.arange(len(signal)), np.arange(len(signal))[::thin], coarse)


def unexplained(log: Log, description: Axis | None, given: Signal | None = None) -> Iterator[Finding]:
    """Bursts that the controller did not give, where that is known (`given`), else those that the table ignores."""
    piece, step = longest_piece(log), sampling_period(log)
    position, command = log.position[piece], log.command[piece]
    if given is None:
        found = find_bursts(command, step)
    else:
        found = find_bursts(command - given[piece], step, min(WINDOW_OF_REST, len(command) * step / 4))
        found = [one for one in found if abs(one.force) > LARGE * float(np.ptp(command))]
    mass = _mass(position, command, step, description)
    silent = [] if mass is None else [one for one in found if _is_ignored(one, position, step, mass)]
    if given is None:
        found, what = silent, "to which the table does not react: this force never acted"
    else:
        what = "which the controller did not give: test pulses, or the logger's"
        if silent:
            what = (
                f"which the controller did not give; to {len(silent)} of them the table does not react: it never acted"
            )
    if not found:
        return
    largest = max(found, key=lambda one: abs(one.force))
    start = log.time[piece.start + largest.start]
    yield Finding(
        "warning",
        "command",
        f"{len(found)} bursts of up to {largest.force:.4g} N, the largest at t = {start:.6g} s for "
        f"{1e3 * (largest.stop - largest.start) * step:.3g} ms, {what}",
        "cut these stretches out and list the gaps, or log the command that reached the amplifier",
        "burst",
    )


def _is_ignored(burst: Burst, position: Signal, step: float, mass: float) -> bool:
    """Whether a table of this mass (kg) would have moved visibly under the burst, and did not."""
    long = burst.stop - burst.start
    # what the impulse alone does within its own length and as long after
    expected = 1.5 * burst.force / mass * (long * step) ** 2
    after, before = min(burst.stop + long, len(position) - 1), max(burst.start - 2 * long, 0)
    at = np.arange(before, burst.start + 1)
    line = np.polynomial.Polynomial.fit(at, position[before : burst.start + 1], 1)
    moved = float(position[after] - line(after))
    return abs(expected) > MOVED * noise_std(position) and abs(moved / expected) < IGNORED


def _mass(position: Signal, command: Signal, step: float, description: Axis | None) -> float | None:
    if description is not None:
        return float(description.drive.plant.mass)
    found = inverse_dynamics(position, command, step)
    return found.mass.value if found is not None and found.mass.value > 2 * found.mass.std else None
