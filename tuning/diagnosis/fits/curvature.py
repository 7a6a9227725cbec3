"""Steps in the curvature of a cost with a prior of one in every direction.

It is nowhere less than the prior's. Beside a direction that the logs tell a hundred million times better, that one is
lost in rounding, and the matrix may be singular.
"""

import numpy as np
from jaxtyping import Array, Float

FARTHEST = 50.0  # standard deviations of the prior in one step: beyond, the curvature meant nothing


def solved(
    curvature: Float[np.ndarray, "k k"], right: Float[np.ndarray | Array, "k ..."]
) -> Float[np.ndarray, "k ..."]:
    """`x` with curvature x = right, no direction bent less than the prior does; NaN where anything is not finite."""
    right = np.asarray(right, float)
    if not (np.all(np.isfinite(curvature)) and np.all(np.isfinite(right))):
        return np.full_like(right, np.nan)
    bent, along = np.linalg.eigh(curvature)
    return along @ ((along.T @ right).T / np.maximum(bent, 1.0)).T


def log_volume(curvature: Float[np.ndarray, "k k"]) -> float:
    """Logarithm of how many times smaller the volume is that the curvature leaves of the prior; NaN if not finite."""
    if not np.all(np.isfinite(curvature)):
        return np.nan
    return float(np.sum(np.log(np.maximum(np.linalg.eigvalsh(curvature), 1.0))))


def limited(step: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """The step, shortened where it would lead further than any prior could mean."""
    return step * min(1.0, FARTHEST / max(float(np.max(np.abs(step), initial=0.0)), 1e-9))
