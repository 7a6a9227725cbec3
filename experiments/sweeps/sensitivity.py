"""Which quantity drives the spread of the errors.

From the machines that were run anyway, however they were drawn: the first-order index, the share of the variance that
goes when a quantity is known (RBD-FAST; Tarantola, Gatelli and Mara 2006; Plischke 2010), and for the tornado the mean
error where the quantity is low and where it is high. Of errors the logarithm is taken: they are skewed.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import mannwhitneyu

FEWEST = 128  # machines, below which indices say nothing
EXACTLY = 4096  # machines, up to which a rank test may count every order
SIXTH = 1.0 / 6.0  # low and high: the lowest and the highest sixth, about a standard deviation off
RESAMPLES = 100


class Influence(NamedTuple):
    """One quantity."""

    name: str
    share: float  # of the variance: 0 to 1
    uncertain: float  # half-width of its 95 % interval
    low: float  # mean where the quantity is low: of errors the geometric one (m), of events how often they happen
    high: float  # where it is high
    chance: float = 1.0  # of events: that they lie so by chance, in any of the quantities


def influences(
    names: Sequence[str], values: Float[np.ndarray, "n d"], errors: Float[np.ndarray, " n"], seed: int = 0
) -> list[Influence]:
    """Every quantity's on the logarithm of the error, the strongest first. Errors (m) that are not finite are left out.

    Empty where nothing varies, where there are too few machines, or where their errors are all the same.
    """
    good = np.isfinite(errors) & (errors > 0.0)
    found = _shares(names, values[good], np.log(errors[good]), seed)
    return [one._replace(low=float(np.exp(one.low)), high=float(np.exp(one.high))) for one in found]


def influences_on_event(
    names: Sequence[str], values: Float[np.ndarray, "n d"], happened: np.ndarray, seed: int = 0
) -> list[Influence]:
    """Every quantity's on whether something happened to a machine, as `influences`.

    Where that is rare (or the rule), no interval of the shares can be told (NaN): `chance` can, by a rank test of where
    the events lie (Mann and Whitney 1947), paid for by how many quantities are looked at.
    """
    return [
        one._replace(chance=min(1.0, len(names) * _chance(values[:, names.index(one.name)], happened)))
        for one in _shares(names, values, happened.astype(float), seed)
    ]


def _chance(values: Float[np.ndarray, " n"], happened: np.ndarray) -> float:
    method = "auto" if len(values) <= EXACTLY else "asymptotic"  # the exact one takes the square of their number
    return float(mannwhitneyu(values[happened], values[~happened], method=method).pvalue)


def _shares(names: Sequence[str], inputs: Float[np.ndarray, "n d"], outputs: np.ndarray, seed: int) -> list[Influence]:
    from SALib.analyze import rbd_fast  # takes two seconds to import

    if len(outputs) < FEWEST or np.ptp(outputs) == 0.0:
        return []
    varies = np.ptp(inputs, axis=0) > 0.0
    names, inputs = [name for name, one in zip(names, varies, strict=True) if one], inputs[:, varies]
    if not names:
        return []
    problem = {"num_vars": len(names), "names": list(names), "bounds": [[0.0, 1.0]] * len(names)}
    with np.errstate(invalid="ignore", divide="ignore"):  # resamples in which all outputs are the same
        found = rbd_fast.analyze(problem, inputs, outputs, num_resamples=RESAMPLES, seed=seed)
    told = []
    for k, name in enumerate(names):
        order = np.argsort(inputs[:, k], kind="stable")
        few = max(1, round(SIXTH * len(order)))
        low, high = (float(np.mean(outputs[part])) for part in (order[:few], order[-few:]))
        told.append(Influence(name, float(np.clip(found["S1"][k], 0.0, 1.0)), float(found["S1_conf"][k]), low, high))
    return sorted(told, key=lambda one: -one.share)
