"""Peaks of a loop's gain above its crossover: resonances, with their dampings."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Complex, Float

HALF_POWER = float(np.sqrt(0.5))  # -3 dB, at the edges of a peak


class Resonance(NamedTuple):
    """A peak of the loop's gain above its crossover."""

    frequency: float  # Hz
    damping: float  # ratio, from its width at -3 dB
    gain: float  # |L| there


def find_resonances(frequency: Float[np.ndarray, " f"], loop: Complex[np.ndarray, " f"]) -> list[Resonance]:
    """The peaks of |L| above the frequency (Hz) from which |L| is below one for the first time, the highest first.

    A peak counts where it falls by 3 dB on both sides before a higher one, so that it has a width.
    """
    gain, log = np.abs(loop), np.log(frequency)
    below = np.flatnonzero(gain < 1.0)
    first = int(below[0]) if below.size else 0
    inner = gain[1:-1]
    peaks = 1 + np.flatnonzero((inner > gain[:-2]) & (inner >= gain[2:]))
    found = []
    for peak in peaks[peaks > first]:
        edge = HALF_POWER * gain[peak]
        under = gain < edge
        left, right = np.flatnonzero(under[first:peak]), np.flatnonzero(under[peak:])
        if not (left.size and right.size):
            continue
        low, high = first + left[-1], peak + right[0]
        if np.max(gain[low : high + 1]) > gain[peak]:
            continue  # a ripple on the flank of a higher one
        edges = [
            np.interp(np.log(edge), np.log(gain[pair]), log[pair])
            for pair in (np.array([low, low + 1]), np.array([high, high - 1]))
        ]
        width = np.exp(edges[1]) - np.exp(edges[0])
        found.append(Resonance(float(frequency[peak]), float(width / (2.0 * frequency[peak])), float(gain[peak])))
    return sorted(found, key=lambda one: -one.gain)
