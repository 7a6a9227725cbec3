"""The uniform clock behind a log's time stamps: its period from the whole log, and where samples are missing."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from diffdrive.logs.log import Signal

EXACT = 1e-6  # of a period: what writing and reading a number may do to a stamp
ROUNDED = 0.05  # of a period: what a clock of coarse resolution does
_LONG = 1.75  # steps beyond this many medians are no single steps
_BREAK = 2.5  # periods without a sample are a gap, even if late samples follow: to fill them would be to invent
_WINDOW = 10  # samples on either side that tell a late stamp from a missing sample


@dataclass(frozen=True)
class UniformClock:
    """Stamps are `times` but for `deviation` (periods, largest and RMS); samples are missing before each of `gaps`."""

    period: float  # s
    times: Signal
    gaps: tuple[int, ...]
    deviation: float
    rms: float


def fit_clock(stamps: Signal, nominal: float | None) -> UniformClock:
    """The grid of strictly increasing stamps (s). The `nominal` period (s) is taken where the stamps allow it."""
    steps = np.diff(stamps)
    period = float(steps[steps <= _LONG * np.median(steps)].mean())
    missing = _count_missing(stamps, period)
    index = np.arange(len(stamps)) + np.concatenate(([0], np.cumsum(missing)))
    gaps = tuple((np.flatnonzero(missing) + 1).tolist())
    one_clock = _fit_segments(stamps, index, np.zeros(len(stamps), dtype=int), gaps, nominal)
    if one_clock.deviation <= ROUNDED or not gaps:
        return one_clock
    # recordings that were stopped and started again: each piece has its own phase
    piece = np.concatenate(([0], np.cumsum(missing > 0)))
    return _fit_segments(stamps, index, piece, gaps, nominal)


def _count_missing(stamps: Signal, period: float) -> np.ndarray:
    """How many samples are missing between each stamp and the next."""
    steps = np.diff(stamps) / period
    rounded = np.rint(steps)
    if np.all((rounded >= 1) & (np.abs(steps - rounded) < 0.25)):
        return rounded.astype(int) - 1
    # a stamp that is only late leaves the later ones where they were; missing samples shift them for good
    lag = (stamps - stamps[0]) / period - np.arange(len(stamps))
    missing = np.zeros(len(steps), dtype=int)
    breaks = np.flatnonzero(steps > _BREAK)
    for k in np.flatnonzero(steps > 1.5):
        before, after = np.searchsorted(breaks, [k, k + 1])
        first = max(k + 1 - _WINDOW, breaks[before - 1] + 1 if before else 0)
        last = min(k + 1 + _WINDOW, breaks[after] + 1 if after < len(breaks) else len(stamps))
        shift = math.floor(np.median(lag[k + 1 : last]) - np.median(lag[first : k + 1]) + 0.5)
        missing[k] = max(shift, 0 if steps[k] <= _BREAK else round(steps[k]) - 1)
    return missing


def _fit_segments(
    stamps: Signal, index: np.ndarray, piece: np.ndarray, gaps: tuple[int, ...], nominal: float | None
) -> UniformClock:
    """Least squares of one period and a phase per piece; a round period is preferred where it explains them as well."""
    size = np.bincount(piece)

    def centred(values: np.ndarray) -> np.ndarray:
        values = values - values[0]
        return values - (np.bincount(piece, values) / size)[piece]

    index_centred, stamps_centred = centred(index), centred(stamps)
    period = (
        float(index_centred @ stamps_centred / (index_centred @ index_centred))
        if index_centred.any()
        else float(np.median(np.diff(stamps)))
    )

    def largest_error(trial: float) -> float:
        return float(np.max(np.abs(stamps_centred - trial * index_centred))) / trial

    for candidate in filter(None, (nominal, 1.0 / float(f"{1.0 / period:.6g}"))):
        if largest_error(candidate) <= 1.2 * largest_error(period) + EXACT:
            period = candidate
            break
    start = np.concatenate(([0], np.flatnonzero(np.diff(piece)) + 1))
    elapsed = period * (index - index[start][piece])
    times = stamps[start][piece] + elapsed
    if np.max(np.abs(stamps - times)) > ROUNDED * period:  # the first stamp is itself a bad one
        ends = [*start, len(stamps)]
        times = times + np.array([np.median((stamps - times)[a:b]) for a, b in itertools.pairwise(ends)])[piece]
    error = (stamps - times) / period
    return UniformClock(period, times, gaps, float(np.max(np.abs(error))), float(np.sqrt(np.mean(error**2))))
