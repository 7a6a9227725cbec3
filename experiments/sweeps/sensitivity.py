"""Which quantity drives the spread of the errors.

From the machines that were run anyway, however they were drawn: the first-order index, the share of the variance that
goes when a quantity is known (RBD-FAST; Tarantola, Gatelli and Mara 2006; Plischke 2010), and for the tornado the mean
error where the quantity is low and where it is high. Of errors the logarithm is taken: they are skewed.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

FEWEST = 128  # machines, below which indices say nothing
SIXTH = 1.0 / 6.0  # low and high: the lowest and the highest sixth, about a standard deviation off
RESAMPLES = 100


class Influence(NamedTuple):
    """One quantity."""

    name: str
    share: float  # of the variance of the logarithm of the error: 0 to 1
    uncertain: float  # half-width of its 95 % interval
    low: float  # geometric mean of the errors (m) where the quantity is low
    high: float  # where it is high


def influences(
    names: Sequence[str], values: Float[np.ndarray, "n d"], errors: Float[np.ndarray, " n"], seed: int = 0
) -> list[Influence]:
    """Every quantity, the strongest first. Machines without a finite error (m) are left out.

    Empty where nothing varies, where there are too few machines, or where their errors are all the same.
    """
    from SALib.analyze import rbd_fast  # takes two seconds to import

    good = np.isfinite(errors) & (errors > 0.0)
    inputs, outputs = values[good], np.log(errors[good])
    if len(outputs) < FEWEST or np.ptp(outputs) == 0.0:
        return []
    varies = np.ptp(inputs, axis=0) > 0.0
    names, inputs = [name for name, one in zip(names, varies, strict=True) if one], inputs[:, varies]
    problem = {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}
    found = rbd_fast.analyze(problem, inputs, outputs, num_resamples=RESAMPLES, seed=seed)
    told = []
    for k, name in enumerate(names):
        order = np.argsort(inputs[:, k], kind="stable")
        few = max(1, round(SIXTH * len(order)))
        low, high = (float(np.exp(np.mean(outputs[part]))) for part in (order[:few], order[-few:]))
        told.append(Influence(name, float(np.clip(found["S1"][k], 0.0, 1.0)), float(found["S1_conf"][k]), low, high))
    return sorted(told, key=lambda one: -one.share)
