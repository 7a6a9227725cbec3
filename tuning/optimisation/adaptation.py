"""A cost of a few numbers without a gradient worth following, minimised by covariance matrix adaptation.

CMA-ES (Hansen and Ostermeier 2001, in cma) learns from the best of each generation along which ways the cost is narrow.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Costs = Callable[[Float[np.ndarray, "s k"]], Float[np.ndarray, " s"]]

WORST = 1e30  # the cost of what is not finite: cma ranks no infinity
PACE = 10  # generations, over which it is looked how fast the cost falls
SETTLED = 0.25  # of the first spread, to which a search has drawn together: before, it may yet come upon a steep place


class Minimum(NamedTuple):
    """The best point that was seen, its cost, and how many points were."""

    share: Float[np.ndarray, " k"]
    cost: float
    simulations: int


def minimum(
    costs: Costs,
    start: Float[np.ndarray, " k"],
    spread: float,
    *,
    population: int,
    simulations: int,
    tolerance: float,
    target: float = np.inf,
    seed: int = 0,
) -> Minimum:
    """Minimise `costs`, which takes points [s, k], over the unit cube.

    From `start`, `population` points at a time, at first `spread` apart; until the generations of late differ by less
    than `tolerance`, or after `simulations`, the generation that passes them included. A search that has drawn together
    ends, too, where the cost is above `target` and would still be after those, if it went on to fall as fast as over
    the last `PACE` generations. A cost that is not finite is the worst. The same seed gives the same answer.
    """
    import cma  # takes a second: only where it is used

    rng = np.random.default_rng(seed)
    options = {
        "bounds": [0.0, 1.0],
        "popsize": population,
        "tolfun": tolerance,
        "tolfunhist": tolerance,
        "verbose": -9,
        "signals_filename": "",
        "randn": lambda *shape: rng.standard_normal(shape),
        "seed": np.nan,  # it would seed numpy's global generator
    }
    best, cost, done = start, _finite(costs(start[None]))[0], 1
    strategy, best_costs = cma.CMAEvolutionStrategy(start, spread, options), [cost]

    def is_hopeless() -> bool:
        if len(best_costs) <= PACE or np.max(strategy.result.stds) > SETTLED * spread:
            return False
        pace = (best_costs[-1 - PACE] - cost) / PACE
        return bool(cost - target > pace * (simulations - done) / population)

    while done < simulations and not strategy.stop() and not is_hopeless():
        points = np.array(strategy.ask())
        found = _finite(costs(points))
        strategy.tell(list(points), list(found))
        done += len(points)
        if found.min() < cost:
            best, cost = points[int(np.argmin(found))], found.min()
        best_costs.append(cost)
    return Minimum(best, float(cost), done)


def _finite(costs: Float[np.ndarray, " s"]) -> Float[np.ndarray, " s"]:
    return np.nan_to_num(costs, nan=WORST, posinf=WORST)
