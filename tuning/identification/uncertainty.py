"""How far estimates can be trusted, also where the model is not quite true.

The covariance is the sandwich H^-1 W H^-1 with H = J'J and W the scatter of the score J'e, summed over blocks of time:
it asks neither for white residuals nor for residuals of the size that the noise would give (White 1982; Newey and West
1987). Blocks are longer than the residual's memory; where there are fewer than parameters, residuals of one colour
throughout are assumed.
"""

from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

LEVEL = 0.95
BLOCK = 0.25  # s, at least
SIGNIFICANCE = 0.01  # that white residuals seem to repeat
MIN_BLOCKS_PER_PARAMETER = 2  # a long memory does not make blocks so long that fewer are left


class Covariance(NamedTuple):
    """Covariance of the search vector y, and what the intervals and the table of correlations need."""

    matrix: Float[np.ndarray, "k k"]
    blocks: int
    condition: float  # of the information matrix, its columns scaled to one

    @property
    def quantile(self) -> float:
        """Half-width of the 95 % interval in standard errors: Student's t, the blocks being what was counted."""
        return float(scipy.stats.t.ppf(0.5 * (1 + LEVEL), max(3, self.blocks - len(self.matrix))))

    @property
    def correlation(self) -> Float[np.ndarray, "k k"]:
        """The correlation matrix."""
        scale = np.sqrt(np.diag(self.matrix))
        return self.matrix / np.outer(scale, scale)


def correlation_length(residual: Float[np.ndarray, "lanes n"]) -> int:
    """Samples after which a residual has forgotten itself: where its autocorrelation first stays within the noise."""
    correlation = autocorrelation(residual, residual.shape[1] // 10)
    counted = max(1, int(np.count_nonzero(residual)))
    inside = np.abs(correlation) < 3.0 / np.sqrt(counted) + 0.02
    outside = np.flatnonzero(~inside)
    return int(outside[-1] + 1) if len(outside) else 1


def autocorrelation(residual: Float[np.ndarray, "lanes n"], lags: int) -> Float[np.ndarray, " lags"]:
    """Autocorrelation of the residual at lags 1 to `lags`, pooled over lanes (zeros do not count)."""
    size = 2 ** int(np.ceil(np.log2(2 * residual.shape[1])))
    power = np.abs(np.fft.rfft(residual, size, axis=1)) ** 2
    covariance = np.fft.irfft(power, size, axis=1).sum(axis=0)
    return covariance[1 : lags + 1] / covariance[0]


def repetition_inflation(residual: Float[np.ndarray, "lanes n"], rate: float) -> float:
    """By how much the variance of estimates is larger because residuals come again later on, as from lap to lap.

    Strokes of a whole number of counts meet the grid of the scale in the same places each time, and so does friction
    that a model lacks: laps that repeat one another are one lap. It is one plus twice the autocorrelations beyond the
    blocks of the sandwich, those that white residuals would exceed once in a hundred logs; biased ones, whose weight
    falls with the lag as the number of pairs does.
    """
    lags = residual.shape[1] - 1
    first = round(BLOCK * rate)
    if lags <= first:
        return 1.0
    far = autocorrelation(residual, lags)[first:]
    counted = max(1, int(np.count_nonzero(residual)))
    chance = float(scipy.stats.norm.isf(SIGNIFICANCE / len(far))) / np.sqrt(counted)
    return 1.0 + 2.0 * max(0.0, float(np.sum(far[np.abs(far) > chance])))


def sandwich(
    residual: Float[np.ndarray, "lanes n"],
    jacobian: Float[np.ndarray, "lanes n k"],
    rate: float,
    prior: Float[np.ndarray, "m k"],
) -> Covariance:
    """Covariance of y from residuals (any unit) and their derivative with respect to y.

    The `prior` on y, the derivative of its terms in standard deviations (tuning.identification.problem.Innovations), is
    part of both H and W: where the data say nothing, that is the standard error.
    """
    lanes, samples, count = jacobian.shape
    # what diverges from a bad point would overflow when squared
    largest = np.maximum(1.0, np.max(np.abs(jacobian), axis=(0, 1)))
    jacobian, believed = jacobian / largest, (prior / largest).T @ (prior / largest)
    information = np.einsum("lnk,lnj->kj", jacobian, jacobian) + believed
    enough = np.count_nonzero(residual) // (MIN_BLOCKS_PER_PARAMETER * count)
    block = min(samples, max(round(BLOCK * rate), min(2 * correlation_length(residual), enough)))
    filled = -(-samples // block) * block  # the last block of a lane may be short
    scores = np.pad(jacobian * residual[:, :, None], ((0, 0), (0, filled - samples), (0, 0)))
    sums = scores.reshape(lanes, -1, block, count).sum(axis=2).reshape(-1, count)
    sums = sums[np.any(sums != 0.0, axis=1)]
    blocks = len(sums)
    scale = np.sqrt(np.diag(information))  # parameters differ by many orders in what the logs say of them
    scaled = information / np.outer(scale, scale)
    inverse = np.linalg.inv(scaled)
    if blocks > count:
        # each fitted parameter has taken a block's worth of scatter out of the sums
        scatter = (sums.T @ sums * (blocks / (blocks - count)) + believed) / np.outer(scale, scale)
        # a few blocks can agree by chance: no variance below that of white residuals
        matrix = _with_variance_floor(inverse @ scatter @ inverse, _variance(residual, 0) * inverse)
    else:
        matrix = _variance(residual, correlation_length(residual)) * inverse
    matrix = matrix / np.outer(scale, scale) / largest[:, None] / largest
    return Covariance(0.5 * (matrix + matrix.T), blocks, float(np.linalg.cond(scaled)))


def _variance(residual: Float[np.ndarray, "lanes n"], lags: int) -> float:
    """Variance of the residual, times one plus twice its autocorrelations up to `lags`, and at least itself."""
    counted = residual[residual != 0.0]
    colour = 1.0 + 2.0 * float(np.sum(autocorrelation(residual, lags))) if len(counted) else 1.0
    return float(np.mean(counted**2)) * max(1.0, colour) if len(counted) else 1.0


def _with_variance_floor(matrix: Float[np.ndarray, "k k"], floor: Float[np.ndarray, "k k"]) -> Float[np.ndarray, "k k"]:
    """The covariance with no variance below that of `floor`, its correlations kept."""
    wider = np.sqrt(np.maximum(1.0, np.diag(floor) / np.diag(matrix)))
    return matrix * np.outer(wider, wider)
