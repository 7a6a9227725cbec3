"""Linear least squares that says which parameters its data determine, and how well."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse.csgraph import connected_components

CONDITION_LIMIT = 300.0  # of unit columns; Belsley 1991 calls a condition above 100 severe


@dataclass(frozen=True)
class Solution:
    """Coefficients [p] (of least norm where the data leave some open), their covariance [p, p], the residuals [n].

    `condition` is that of the columns scaled to unit length, over the directions that are determined; `open_groups` are
    the indices of coefficients that cannot be told apart from one another (or, alone, from zero).
    """

    coefficients: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    residuals: Float[np.ndarray, " n"]
    condition: float
    undetermined_groups: tuple[tuple[int, ...], ...]


def solve(columns: Float[np.ndarray, "n p"], target: Float[np.ndarray, " n"], lengths: Sequence[int]) -> Solution:
    """Least squares of `target` on `columns`, whose rows are pieces of consecutive samples, `lengths` long each.

    A row of zeros, target included, is a sample left out. Columns are scaled to unit length first; directions whose
    singular value is a `CONDITION_LIMIT`-th of the largest or less are open and kept out of the solution.
    """
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    unit = columns / scale
    left, singular_values, right = np.linalg.svd(unit, full_matrices=False)
    determined = singular_values > singular_values[0] / CONDITION_LIMIT
    inverse = right[determined].T / singular_values[determined]
    coefficients = inverse @ (left[:, determined].T @ target)
    residuals = target - unit @ coefficients
    bread = inverse @ inverse.T
    scores = np.split(unit * residuals[:, None], np.cumsum(lengths)[:-1])
    count = int(np.count_nonzero(np.any(columns != 0, axis=1)))
    freedom = count / max(count - len(singular_values), 1)
    covariance = freedom * bread @ long_run_covariance(scores) @ bread
    return Solution(
        coefficients=coefficients / scale,
        covariance=covariance / np.outer(scale, scale),
        residuals=residuals,
        condition=float(singular_values[0] / singular_values[determined][-1]),
        undetermined_groups=_groups(right[~determined]),
    )


def _groups(null: Float[np.ndarray, "k p"]) -> tuple[tuple[int, ...], ...]:
    """The parameters that the directions `null` (orthonormal rows) mix with one another."""
    shared = np.abs(null.T @ null)
    part = np.sqrt(np.diag(shared)) > 0.1  # less than that is rounding, or a hundredth of the variance
    links = (shared > 0.01) & np.outer(part, part)
    _, label = connected_components(links, directed=False)
    members = [tuple(np.flatnonzero((label == k) & part).tolist()) for k in range(label.max() + 1)]
    return tuple(group for group in members if group)


def long_run_covariance(scores: Sequence[Float[np.ndarray, "n p"]]) -> Float[np.ndarray, "p p"]:
    """Covariance of the sum of the scores, consistent under heteroskedasticity and autocorrelation.

    Newey and West 1987 (Bartlett weights, so it is never negative) with the automatic bandwidth of Andrews 1991 from a
    first-order autoregression of each column. Lags do not reach from one piece into another.
    """
    count = sum(len(piece) for piece in scores)
    power = sum(np.sum(piece**2, axis=0) for piece in scores)
    neighbours = sum(np.sum(piece[1:] * piece[:-1], axis=0) for piece in scores)
    memory = np.clip(neighbours / np.where(power > 0, power, 1.0), -0.97, 0.97)
    weight = ((1 - memory**2) * power) ** 2
    bias = np.sum(weight * 4 * memory**2 / ((1 - memory) ** 6 * (1 + memory) ** 2))
    variance = np.sum(weight / (1 - memory) ** 4)
    bandwidth = max(1.0, 1.1447 * (count * bias / variance) ** (1 / 3)) if variance > 0 else 1.0
    total = sum(piece.T @ piece for piece in scores)
    for lag in range(1, min(int(np.ceil(bandwidth)), max(len(piece) for piece in scores))):
        product = sum(piece[lag:].T @ piece[:-lag] for piece in scores if len(piece) > lag)
        total = total + (1 - lag / bandwidth) * (product + product.T)
    return total
