"""Which machines a sweep runs: shares of the probability of each quantity that varies, part by part.

A part is a block of samples that is drawn for itself, from the sweep's seed and its own number: any part can be run
anywhere, or again, without the others. Sobol points go on from part to part (their sequence is one); random ones are
independent anyway; Latin hypercubes are one hypercube in each part.
"""

from typing import Literal, get_args

import numpy as np
from jaxtyping import Float
from scipy.stats import qmc

from diffdrive.errors import ParameterError

Method = Literal["sobol", "latin-hypercube", "random"]


def shares(method: Method, dimensions: int, seed: int, part: int, size: int) -> Float[np.ndarray, "size d"]:
    """The samples of part number `part`, `size` of them, a power of two (Sobol points are balanced by then).

    Raises `ParameterError` for another method or size.
    """
    if method not in get_args(Method):
        raise ParameterError(f"samples: '{method}' is no method; known: {', '.join(get_args(Method))}")
    if size < 1 or size & (size - 1):
        raise ParameterError(f"samples: a part must hold a power of two of them, got {size}")
    if not dimensions:
        return np.zeros((size, 0))
    if method == "sobol":
        sequence = qmc.Sobol(dimensions, rng=np.random.default_rng(seed))
        if part:
            sequence.fast_forward(size * part)
        return np.asarray(sequence.random(size))
    own = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(part,)))
    if method == "latin-hypercube":
        return np.asarray(qmc.LatinHypercube(dimensions, rng=own).random(size))
    return own.random((size, dimensions))
