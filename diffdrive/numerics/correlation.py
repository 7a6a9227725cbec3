"""Correlations of named quantities: from pairs to a matrix, and to the root that draws them together."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from diffdrive.errors import ParameterError

ROUNDING = 0.01  # of a correlation: numbers that were rounded may be of no quantities by as much

Correlation = Mapping[str, Mapping[str, float]]  # of pairs of names, each pair once or twice


def correlation_matrix(correlation: Correlation, names: Sequence[str], absent: str) -> Float[np.ndarray, "d d"]:
    """The matrix of the correlations between `names`; pairs that are not stated are independent.

    Raises `ParameterError` for a pair that has not one number from -1 to 1, and for a name that is not among `names`,
    of which the message says that it is `absent`.
    """
    matrix = np.eye(len(names))
    for name, others in correlation.items():
        for other, value in others.items():
            if name not in names or other not in names:
                missing = name if name not in names else other
                raise ParameterError(f"correlation: {missing} {absent}")
            if name == other:
                continue
            a, b = names.index(name), names.index(other)
            if not -1.0 <= value <= 1.0 or matrix[a, b] not in (0.0, value):
                raise ParameterError(f"correlation: of {name} and {other} is {value!r}: one number from -1 to 1")
            matrix[a, b] = matrix[b, a] = value
    return matrix


def root_of(matrix: Float[np.ndarray, "d d"]) -> Float[np.ndarray, "d d"]:
    """A matrix whose product with its transpose is this one of correlations.

    What rounding made impossible becomes what is possible nearby. Raises `ParameterError` for numbers that no
    quantities can have.
    """
    bends, along = np.linalg.eigh(matrix)
    root = along * np.sqrt(np.clip(bends, 0.0, None)) @ along.T
    root /= np.linalg.norm(root, axis=1, keepdims=True)
    if np.abs(root @ root.T - matrix).max() > ROUNDING:
        raise ParameterError("correlation: no quantities can be correlated like that (the matrix is not positive)")
    return np.asarray(root)
