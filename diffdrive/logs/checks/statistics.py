"""Robust estimates: standard deviation, linear fits, speed; and stretches of equal samples."""

from typing import NamedTuple

import numpy as np
from scipy.signal import savgol_filter

from diffdrive.logs.log import Log, Signal

SIGMA_PER_MAD = 1.4826  # of a normal distribution
SMOOTHING = 0.02  # s: resolves the motion of a feed axis, and averages out its scale's counts
_MOST_ITERATIONS = 15  # of Huber's weights, at most
_MOST_SAMPLES = 200_000  # samples: a standard error of 0.2 % of what scatters


def robust_std(values: Signal) -> float:
    """Standard deviation of the bulk of the values, from their median absolute deviation."""
    return SIGMA_PER_MAD * float(np.median(np.abs(values - np.median(values))))


class RobustFit(NamedTuple):
    """Coefficients, and the RMS of the residual without its largest hundredth, over the RMS of y about its mean."""

    coefficients: np.ndarray
    error: float
    residual: np.ndarray


def robust_fit(columns: list[Signal], y: Signal) -> RobustFit:
    """Fit y by a combination of the columns (Huber's weights); a constant column is appended and comes last.

    The error is measured without the worst hundredth of the samples, so that spikes, clipped peaks and reversals do
    not decide whether two signals agree.
    """
    std = float(np.std(y))
    tiny = np.finfo(float).tiny
    scales = np.array([max(float(np.sqrt(np.mean(column**2))), tiny) for column in columns] + [1.0])
    regressors = np.ones((len(scales), len(y)))  # a row each: sums over samples run along the memory
    for k, column in enumerate(columns):
        np.divide(column, scales[k], out=regressors[k])
    solution = np.zeros(len(scales))
    # of a long log every so-manieth sample decides: it holds more of them than any estimate needs
    stride = 1 + len(y) // _MOST_SAMPLES
    subset, target = np.ascontiguousarray(regressors[:, ::stride]), y[::stride]
    residual = target.astype(float)
    weights = np.ones_like(residual)
    for _ in range(_MOST_ITERATIONS):
        # a correction by the normal equations: each round refines the last one, so that their rounding does not stay
        weighted = subset * weights
        step = np.linalg.lstsq(weighted @ subset.T, weighted @ residual, rcond=None)[0]
        solution = solution + step
        residual = target - solution @ subset
        if float(np.max(np.abs(step))) < 1e-9 * std:
            break
        size = np.abs(residual)
        residual_std = max(SIGMA_PER_MAD * float(np.median(size)), 1e-9 * std, tiny)
        weights = residual_std / np.maximum(size, residual_std)
    residual = y - solution @ regressors
    kept = max(1, int(0.99 * len(residual)))
    bulk = np.partition(np.abs(residual), kept - 1)[:kept]
    return RobustFit(solution / scales, float(np.sqrt(bulk @ bulk / kept)) / max(std, tiny), residual)


def percent(share: float) -> str:
    """A share as per cent with two digits, such as 0.24, 3.5 or 100."""
    return f"{float(f'{100 * share:.2g}'):g}"


class EqualStretch(NamedTuple):
    """A stretch of equal samples, [start, stop)."""

    start: int
    stop: int

    @property
    def length(self) -> int:
        """Samples in the stretch."""
        return self.stop - self.start


def equal_stretches(values: Signal, at_least: int) -> list[EqualStretch]:
    """Stretches of at least so many samples that are equal to the last bit."""
    edges = np.flatnonzero(np.diff(values) != 0) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [len(values)]])
    long = stops - starts >= at_least
    return [EqualStretch(int(a), int(b)) for a, b in zip(starts[long], stops[long], strict=True)]


def longest_piece(log: Log) -> slice:
    """The longest stretch without a gap."""
    return max(log.pieces(), key=lambda piece: piece.stop - piece.start)


def sampling_period(log: Log) -> float:
    """Seconds from sample to sample, the mean over all stretches without a gap: rounding of the stamps averages out."""
    pieces = [log.time[piece] for piece in log.pieces() if piece.stop - piece.start > 1]
    steps = np.concatenate([np.diff(piece) for piece in pieces])
    regular = steps[steps < 1.5 * np.median(steps)]  # gaps that nobody listed are no steps
    return float(np.mean(regular))


def window_length(rate: float, seconds: float) -> int:
    """An odd number of samples, at least 5, that spans about so many seconds."""
    return max(5, 2 * int(seconds * rate / 2) + 1)


class SmoothedSignal(NamedTuple):
    """A signal without its noise, and its first two derivatives."""

    value: Signal
    first_derivative: Signal  # per s
    second_derivative: Signal  # per s^2


def smooth_signal(signal: Signal, period: float, seconds: float = SMOOTHING) -> SmoothedSignal:
    """The signal and its derivatives by local cubics over `seconds`."""
    return SmoothedSignal(*(derivative(signal, period, order, seconds) for order in range(3)))


def derivative(signal: Signal, period: float, order: int, seconds: float = SMOOTHING) -> Signal:
    """One derivative of the smoothed signal; order 0 is the signal without its noise."""
    length = window_length(1.0 / period, seconds)
    if len(signal) <= length:
        length = max(5, 2 * ((len(signal) - 1) // 2) - 1)
    return savgol_filter(signal, length, 3, deriv=order, delta=period)


def top_speed(position: Signal, period: float) -> float:
    """Largest speed (m/s) that is held for some milliseconds, so that no single sample makes it."""
    speed = np.abs(derivative(position, period, 1))
    return float(np.quantile(speed, 0.999))
