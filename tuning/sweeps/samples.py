"""Which machines a sweep runs: shares of the probability of each quantity that varies, part by part.

A part is a block of samples that is drawn for itself, from the sweep's seed and its own number: any part can be run
anywhere, or again, without the others. Sobol points go on from part to part (their sequence is one); random ones are
independent anyway; Latin hypercubes are one hypercube in each part.
"""

from collections.abc import Sequence
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from scipy.special import ndtr, ndtri
from scipy.stats import qmc

from diffdrive.errors import ParameterError
from diffdrive.numerics.correlation import Correlation, correlation_matrix, root_of

Method = Literal["sobol", "latin-hypercube", "random"]


def unit_samples(
    method: Method, dimensions: int, seed: int, part: int, size: int, count: int | None = None
) -> Float[np.ndarray, "count d"]:
    """The samples of part number `part`, `size` of them, a power of two (Sobol points are balanced by then).

    `count` are how many of the part are asked for: the first ones, or a hypercube of so many.

    Raises `ParameterError` for another method or size.
    """
    if method not in get_args(Method):
        raise ParameterError(f"samples: '{method}' is no method; known: {', '.join(get_args(Method))}")
    if size < 1 or size & (size - 1):
        raise ParameterError(f"samples: a part must hold a power of two of them, got {size}")
    count = size if count is None else count
    if not dimensions:
        return np.zeros((count, 0))
    if method == "sobol":
        sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
        if part:
            sequence.fast_forward(size * part)
        return np.asarray(sequence.random(size))[:count]
    own = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(part,)))
    if method == "latin-hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, rng=own).random(count))
    return own.random((count, dimensions))


def correlation_root(correlation: Correlation, names: Sequence[str]) -> Float[np.ndarray, "d d"] | None:
    """A matrix whose product with its transpose is the correlation between `names`; None where there is none.

    `correlation` holds pairs of names, each pair once or twice. Raises `ParameterError` for numbers that no quantities
    can have. What rounding made impossible becomes what is possible nearby.
    """
    return root_of(correlation_matrix(correlation, names, "is not varied")) if correlation else None


def correlate(shares: Float[np.ndarray, "n d"], root: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "n d"]:
    """The shares with the correlations of a `root`, each still uniform for itself (a Gaussian copula)."""
    least = np.finfo(float).eps
    normal = ndtri(np.clip(shares, least, 1.0 - least))
    return np.asarray(ndtr(normal @ root.T))
