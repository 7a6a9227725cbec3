"""Which quantity drives the spread of the errors.

From the machines that were run anyway: the first-order index, the share of the variance that goes when a quantity is
known, and for the tornado the mean error where the quantity is low and where it is high. Of errors the logarithm is
taken: they are skewed.

The index is the adjusted R^2 of a polynomial in the quantity's rank (a one-dimensional polynomial chaos expansion;
Sudret 2008), its interval a grouped jackknife's. Polynomials of low degree see no more in Sobol points or a hypercube
than is there. Methods that expect the other quantities at random where one is sorted do: RBD-FAST gave up to 64 % to
quantities without any influence.
"""

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.polynomial.legendre import legvander
from scipy.stats import mannwhitneyu

MIN_MACHINES = 128  # machines, below which indices say nothing
MAX_EXACT = 4096  # machines, up to which a rank test may count every order
TAIL = 1.0 / 6.0  # low and high: the lowest and the highest sixth, about a standard deviation off
DEGREE, GROUPS = 6, 32  # of the polynomial; machines that the jackknife leaves out together
NORMAL_95 = 1.96  # standard deviations of 95 %
MIN_EVENTS = 32  # below so many, or so few that it did not happen to, shares of events have no interval


class Influence(NamedTuple):
    """One quantity."""

    name: str
    share: float  # of the variance: 0 to 1
    uncertain: float  # half-width of its 95 % interval
    low: float  # mean where the quantity is low: of errors the geometric one (m), of events how often they happen
    high: float  # where it is high
    chance: float = 1.0  # of events: that they lie so by chance, in any of the quantities

    @property
    def is_significant(self) -> bool:
        """Whether the share is more than its interval: the others may be noise."""
        return self.share > self.uncertain


def influences(
    names: Sequence[str], values: Float[np.ndarray, "n d"], errors: Float[np.ndarray, " n"], seed: int = 0
) -> list[Influence]:
    """Every quantity's on the logarithm of the error, the strongest first. Errors (m) that are not finite are left out.

    Empty where nothing varies, where there are too few machines, or where their errors are all the same.
    """
    good = np.isfinite(errors) & (errors > 0.0)
    found = _influences(names, values[good], np.log(errors[good]), seed)
    return [
        influence._replace(low=float(np.exp(influence.low)), high=float(np.exp(influence.high))) for influence in found
    ]


def influences_on_event(
    names: Sequence[str], values: Float[np.ndarray, "n d"], happened: np.ndarray, seed: int = 0
) -> list[Influence]:
    """Every quantity's on whether something happened to a machine, as `influences`.

    Where that is rare (or the rule), the shares have no interval (NaN), but a `chance`: that of a rank test of where
    the events lie (Mann and Whitney 1947), paid for by how many quantities are looked at.
    """
    rare = min(np.sum(happened), np.sum(~happened)) < MIN_EVENTS
    return [
        influence._replace(
            uncertain=np.nan if rare else influence.uncertain,
            chance=min(1.0, len(names) * _p_value(values[:, names.index(influence.name)], happened)),
        )
        for influence in _influences(names, values, happened.astype(float), seed)
    ]


def _p_value(values: Float[np.ndarray, " n"], happened: np.ndarray) -> float:
    method: Literal["auto", "asymptotic"] = (
        "auto" if len(values) <= MAX_EXACT else "asymptotic"
    )  # the exact one takes the square of their number
    return float(mannwhitneyu(values[happened], values[~happened], method=method).pvalue)


def _influences(
    names: Sequence[str], inputs: Float[np.ndarray, "n d"], outputs: np.ndarray, seed: int
) -> list[Influence]:
    if len(outputs) < MIN_MACHINES or np.ptp(outputs) == 0.0:
        return []
    group = np.random.default_rng(seed).permutation(len(outputs)) % GROUPS
    influences = []
    for name, values in zip(names, inputs.T, strict=True):
        if np.ptp(values) == 0.0:
            continue
        order = np.argsort(values, kind="stable")
        few = max(1, round(TAIL * len(order)))
        low, high = (float(np.mean(outputs[part])) for part in (order[:few], order[-few:]))
        influences.append(Influence(name, *_first_order(order, outputs, group), low, high))
    return sorted(influences, key=lambda influence: -influence.share)


def _first_order(order: np.ndarray, outputs: np.ndarray, group: np.ndarray) -> tuple[float, float]:
    """The share of the variance of `outputs` that a quantity explains whose `order` this is, and its uncertainty."""
    count = len(order)
    rank = np.empty(count)
    rank[order] = (2.0 * np.arange(count) + 1.0) / count - 1.0
    known = np.column_stack([legvander(rank, DEGREE), (outputs - np.mean(outputs)) / np.std(outputs)])
    products = np.stack([known[group == number].T @ known[group == number] for number in range(GROUPS)])
    total = products.sum(axis=0)
    without = np.array([_adjusted_r_squared(total - group_products) for group_products in products])
    spread = np.sqrt((GROUPS - 1) * np.mean((without - np.mean(without)) ** 2))
    return float(np.clip(_adjusted_r_squared(total), 0.0, 1.0)), float(NORMAL_95 * spread)


def _adjusted_r_squared(products: np.ndarray) -> float:
    """Adjusted R^2 of the last column on the others, the first of which is ones, from all their products."""
    cross, count = products[:-1, -1], products[0, 0]
    left = products[-1, -1] - cross @ np.linalg.solve(products[:-1, :-1], cross)
    spread = products[-1, -1] - cross[0] ** 2 / count
    return 1.0 - (left / (count - DEGREE - 1)) / (spread / (count - 1)) if spread > 0.0 else 0.0
