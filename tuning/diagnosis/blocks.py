"""Sums over pieces of time, by which two explanations are compared: what is left of structure lasts no longer."""

import numpy as np
from jaxtyping import Float

BLOCK = 0.25  # s


def block_sums(each: Float[np.ndarray, "lanes n *k"], rate: float) -> Float[np.ndarray, "lanes blocks *k"]:
    """Of what each sample counts, over every block; the last of a log may be shorter."""
    begins = np.arange(0, each.shape[1], max(1, round(BLOCK * rate)))
    found: Float[np.ndarray, "lanes blocks *k"] = np.add.reduceat(each, begins, axis=1)
    return found
