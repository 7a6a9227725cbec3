"""Lines in what is missing: periods in time and in position that stand out, to begin from.

A grid fine enough for a period that is known to a hundredth of a cycle over the whole log is too fine for the
catalogue: the spectrum of the missing force tells where to look.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import fft, ndimage

from tuning.diagnosis.blocks import block_sums
from tuning.diagnosis.filter.ekf import force_per_innovation
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.levels import SURELY

MOST_PLACES = 2**21  # of a travel, told apart
PEAKS, STRONG = 4, 2  # that stand out most from their neighbourhood, and those of a wide one
REFINED = 9  # values that are tried about a line
LATEST = 0.01  # s, that the missing force is seen late at most
SHADOW = 0.5  # of a line's energy: one that has less left beside another is the other's shadow
AS_GOOD = 0.9  # of a line's energy: a shadow that explains as much may as well be the line itself
NEIGHBOURS = 40  # bins, whose median a line must stand out from
WIDE = 2000  # bins, of a wide one
FOOT = 8.0  # times its neighbourhood, that a line with a foot of its own is
APART = 3  # bins between two lines


def missing_force(fitted: Fitted) -> Float[np.ndarray, "lanes n"]:
    """The force (N) that the filter had to invent, the lasting and the sudden; zero where nothing was measured."""
    sampling = fitted.model.logged.sampling
    counts = np.asarray(fitted.model.logged.lanes.counts)
    sudden = force_per_innovation(fitted.filtered, fitted.drive, sampling.rate) * np.asarray(fitted.filtered.innovation)
    return (np.asarray(fitted.filtered.disturbance) + sudden) * counts


class Line(NamedTuple):
    """A peak of a spectrum."""

    dimension: str  # "frequency" or "position"
    value: float  # Hz, or m of travel from one wave to the next
    share: float  # of the energy
    p_value: float  # that the highest of so many bins of noise stands out so far


def _stand_out(power: Float[np.ndarray, " n"]) -> list[tuple[int, float]]:
    """Indices of the highest peaks over their neighbourhood, and how often noise would stand out so far.

    A strong line that the motion meets unevenly stands on a foot of its own, which raises its neighbourhood: of those
    that stand out from it at all, the strongest over a wide one follow.
    """
    over = power / np.maximum(ndimage.median_filter(power, 2 * NEIGHBOURS + 1, mode="mirror"), 1e-300)
    level = [np.median(some) for some in np.array_split(power, max(1, len(power) // WIDE))]
    widely = power / np.maximum(np.repeat(level, [len(some) for some in np.array_split(power, len(level))]), 1e-300)
    found: list[tuple[int, float]] = []
    for ratio, most in ((over, PEAKS), (np.where(over > FOOT, widely, 0.0), PEAKS + STRONG)):
        for index in np.argsort(ratio)[::-1]:
            if len(found) == most or not ratio[index] > 0.0:
                break
            if all(abs(index - other) > APART for other, _ in found):
                # the power of noise is distributed exponentially, and its median is ln 2 of its mean
                found.append((int(index), float(min(1.0, len(power) * 2.0 ** -min(over[index], 1e3)))))
    return found


def lines_in_time(signal: Float[np.ndarray, "lanes n"], rate: float) -> list[Line]:
    """Lines shared by the lanes, the clearest first."""
    n = signal.shape[1]
    power = np.sum(np.abs(np.fft.rfft(signal * np.hanning(n), 2 * n, axis=1)) ** 2, axis=0)
    axis = np.fft.rfftfreq(2 * n, 1.0 / rate)
    usable = (axis > 2.0) & (axis < 0.45 * rate)
    found = []
    for k, p in _stand_out(power[usable]):
        share = power[usable][max(0, k - APART) : k + APART + 1].sum() / max(power.sum(), 1e-300)
        found.append(Line("frequency", float(axis[usable][k]), float(share), p))
    return found


def lines_in_position(
    signal: Float[np.ndarray, "lanes n"],
    position: Float[np.ndarray, "lanes n"],
    counts: Float[np.ndarray, "lanes n"],
    shortest: float = 5e-4,
    longest: float | None = None,
) -> list[Line]:
    """Lines between two periods (m; the longest by default half of the travel), the clearest first.

    Over a long travel short periods are too many for a transform: none is looked for below travel / 262144.
    """
    at = position[counts > 0]
    low, travel = float(at.min()), max(float(np.ptp(at)), 1e-9)
    longest = 0.5 * travel if longest is None else longest
    shortest = max(shortest, 8.0 * travel / MOST_PLACES)
    bins = np.arange(max(1, round(4.0 * travel / longest)), round(4.0 * travel / shortest))
    waves = bins / (4.0 * travel)
    if len(waves) < 4:
        return []
    # the signal summed over equal places, then a transform of that
    edges = fft.next_fast_len(max(int(8 * travel / shortest), 16), real=True)
    power, energy = np.zeros(len(waves)), np.zeros(len(waves))
    for one, where, there in zip(signal * counts, position, counts, strict=True):
        place = np.clip(((where - low) / travel * edges).astype(int), 0, edges - 1)
        number = np.bincount(place, there, edges)
        held = np.bincount(place, one, edges) / np.maximum(number, 1.0)  # each place speaks once, however long the rest
        transform = np.abs(fft.rfft(held, 4 * edges)[bins]) ** 2
        power += transform
        # half the square of the wave's amplitude, for as long as the lane lasts
        energy += there.sum() * 2.0 * transform / max(int(np.count_nonzero(number)), 1) ** 2
    energy /= max(float(np.sum(signal**2 * counts)), 1e-300)
    return [Line("position", float(1.0 / waves[k]), float(min(1.0, energy[k])), p) for k, p in _stand_out(power)]


class Standing(NamedTuple):
    """A line that is no other's shadow; its share is of the energy over the whole log."""

    line: Line
    rival: Line | None = None  # of the other dimension, which these logs cannot tell from it


class _Wave(NamedTuple):
    line: Line
    columns: Float[np.ndarray, "lanes n 2"]  # cosine and sine where the signal counts


def _fitted(
    signal: Float[np.ndarray, "lanes n"], *columns: Float[np.ndarray, "lanes n 2"]
) -> Float[np.ndarray, "lanes n"]:
    """What of the signal lies along the columns, in each lane by itself."""
    basis = np.linalg.qr(np.concatenate(columns, axis=2))[0]
    return np.einsum("lnk,lk->ln", basis, np.einsum("lnk,ln->lk", basis, signal))


def _wave(
    line: Line,
    signal: Float[np.ndarray, "lanes n"],
    position: Float[np.ndarray, "lanes n"],
    velocity: Float[np.ndarray, "lanes n"],
    counts: Float[np.ndarray, "lanes n"],
    rate: float,
) -> _Wave:
    """The wave at a line, about which its value is sought more finely."""
    time = np.arange(signal.shape[1]) / rate
    lags: Iterable[float]
    if line.dimension == "frequency":
        near, lags = line.value + 0.5 * np.linspace(-1, 1, REFINED) / time[-1], [0.0]
    else:
        travel = max(float(np.ptp(position[counts > 0])), 1e-9)
        near, lags = 1.0 / line.value + 0.25 * np.linspace(-1, 1, REFINED) / travel, np.linspace(0, LATEST, REFINED)
    best = (-1.0, line.value, np.zeros(signal.shape, complex))
    for lag in lags:
        turns = np.broadcast_to(time, signal.shape) if line.dimension == "frequency" else position - lag * velocity
        for each in near[near > 0]:
            wave = np.exp(2j * np.pi * each * turns) * counts
            energy = float(np.sum(np.abs(np.sum(wave * signal, axis=1)) ** 2 / np.maximum(counts.sum(axis=1), 1.0)))
            if energy > best[0]:
                best = (energy, each if line.dimension == "frequency" else 1.0 / each, wave)
    columns = np.stack([best[2].real, best[2].imag], axis=2)
    share = np.sum(_fitted(signal, columns) ** 2) / max(np.sum(signal**2), 1e-300)
    return _Wave(line._replace(value=float(best[1]), share=float(share)), columns)


def told_apart(
    lines: list[Line],
    signal: Float[np.ndarray, "lanes n"],
    position: Float[np.ndarray, "lanes n"],
    velocity: Float[np.ndarray, "lanes n"],
    counts: Float[np.ndarray, "lanes n"],
    rate: float,
) -> list[Standing]:
    """The lines that are no other's shadow, the strongest first.

    A ripple that is met at one speed is a line in time as well, and a vibration leaves its mark on the places where the
    table was. Over the whole log, with all its speeds, the true one explains most, and beside it little is left for the
    others: they are its shadows. A shadow in the other dimension that explains as much is a rival: no speed tells.
    """
    signal = signal * counts
    waves = [_wave(one, signal, position, velocity, counts, rate) for one in lines]
    adds = [_fitted(signal, one.columns) for one in waves]
    taken: list[np.ndarray] = []
    found, known = [], np.zeros_like(signal)
    while waves:
        first = int(np.argmax([np.sum(one**2) for one in adds]))
        best, fit = waves.pop(first), adds.pop(first)
        taken.append(best.columns)
        beside = [_fitted(signal, *taken, one.columns) - known - fit for one in waves]
        shadows = [
            np.sum(more**2) < SHADOW * one.line.share * np.sum(signal**2)
            for one, more in zip(waves, beside, strict=True)
        ]
        rivals = [
            one.line
            for one, other, shadow in zip(waves, adds, shadows, strict=True)
            if shadow and one.line.dimension != best.line.dimension and not _surely(signal - known, fit, other, rate)
        ]
        found.append(Standing(best.line, rivals[0] if rivals else None))
        known = known + fit
        waves = [one for one, shadow in zip(waves, shadows, strict=True) if not shadow]
        adds = [more for more, shadow in zip(beside, shadows, strict=True) if not shadow]
    return found


def _surely(
    signal: Float[np.ndarray, "lanes n"],
    fit: Float[np.ndarray, "lanes n"],
    other: Float[np.ndarray, "lanes n"],
    rate: float,
) -> bool:
    """Whether one fit explains more than another by more than chance and by more than a little."""
    over = (signal - other) ** 2 - (signal - fit) ** 2
    blocks = block_sums(over, rate)
    return bool(blocks.sum() > max(SURELY * np.sqrt(np.sum(blocks**2)), (1.0 - AS_GOOD) * np.sum(fit**2)))
