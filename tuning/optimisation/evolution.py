"""The genetic baseline: differential evolution on the very objective, bounds and start of a gradient search.

Friction is commonly identified by genetic algorithms, as in the paper. Differential evolution (Storn and Price 1997, in
scipy) stands for them here; a generation is one compiled program of simulations side by side.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax import lax
from jaxtyping import Array, Float, PyTree

from tuning.optimisation.least_squares import Residuals
from tuning.optimisation.space import SearchSpace

POPULATION = 3  # members per free parameter: quicker on EMPS than 5 or 15 (docs/evidence/identification-baseline.md)
BLOCK = 32  # simulations side by side
EDGE = 1e-4  # of each parameter's range, that its sigmoid nears but never reaches
DIVERGED_COST = 1e30  # the cost of a simulation that is not finite: differential evolution takes no infinity

Population = Float[np.ndarray, "s k"]  # of shares, 0 to 1, of each parameter's range
Costs = Callable[[Population], Float[np.ndarray, " s"]]


class Budget(NamedTuple):
    """When to stop at the latest (after the generation that passes it), and the cost that is good enough."""

    simulations: int
    seconds: float
    cost: float = 0.0


class HistoryEntry(NamedTuple):
    """The lowest cost after so many simulations."""

    simulations: int
    seconds: float
    cost: float


@dataclass(frozen=True)
class Evolution:
    """Where a population ended: its best member, why it stopped, and the lowest cost along the way."""

    share: Float[np.ndarray, " k"]
    cost: float
    status: str
    history: list[HistoryEntry]  # generation by generation

    @property
    def simulations(self) -> int:
        """How many."""
        return self.history[-1].simulations


def evolve(
    costs: Costs,
    start: Float[np.ndarray, " k"],
    budget: Budget,
    *,
    population: int = POPULATION,
    seed: int = 0,
    progress: Callable[[HistoryEntry], None] = lambda visit: None,
) -> Evolution:
    """Minimise `costs` over the unit cube; `start` is one member of the first population, the others fill it evenly.

    Differential evolution with scipy's defaults (best1bin, mutation 0.5 to 1, recombination 0.7), without its final
    gradient polish. Costs that are not finite count as the worst.
    """
    started, history, status = time.perf_counter(), list[HistoryEntry](), "converged: the population has collapsed"

    def generation(shares: Float[np.ndarray, "k s"]) -> Float[np.ndarray, " s"]:
        found = np.nan_to_num(costs(shares.T), nan=DIVERGED_COST, posinf=DIVERGED_COST)
        simulations, _, lowest = history[-1] if history else HistoryEntry(0, 0.0, np.inf)
        now = time.perf_counter() - started
        history.append(HistoryEntry(simulations + len(found), now, min(lowest, float(found.min()))))
        progress(history[-1])
        return found

    def stop(intermediate_result: scipy.optimize.OptimizeResult) -> None:
        nonlocal status
        simulations, seconds, cost = history[-1]
        if cost <= budget.cost:
            status = "good enough"
        elif simulations >= budget.simulations:
            status = f"stopped after {simulations} simulations"
        elif seconds >= budget.seconds:
            status = f"stopped after {seconds:.0f} s"
        else:
            return
        raise StopIteration

    found = scipy.optimize.differential_evolution(  # type: ignore[call-overload]  # arrays of costs, members as rows
        generation,
        [(EDGE, 1.0 - EDGE)] * len(start),
        x0=np.clip(start, 2 * EDGE, 1.0 - 2 * EDGE),
        init="latinhypercube",
        popsize=population,
        maxiter=max(1, budget.simulations),  # never reached: a generation has several members
        tol=1e-6,
        seed=np.random.default_rng(seed),
        callback=stop,
        polish=False,
        vectorized=True,
        updating="deferred",
    )
    return Evolution(found.x, float(found.fun), status, history)


@eqx.filter_jit
def _norms(residuals: Residuals, points: Float[Array, "s k"], args: PyTree, block: int) -> Float[Array, " s"]:
    return lax.map(lambda theta: jnp.linalg.norm(residuals(theta, args)), points, batch_size=block)


def norm_costs(residuals: Residuals, space: SearchSpace, args: PyTree, block: int = BLOCK) -> Costs:
    """The root of the sum of squares of `residuals(theta, args)`, the cost of `tuning.optimisation.least_squares`, over
    `space`.
    """

    def costs(shares: Population) -> Float[np.ndarray, " s"]:
        return np.asarray(_norms(residuals, jnp.asarray(theta_at(space, shares)), args, block))

    return costs


def theta_at(space: SearchSpace, shares: Float[np.ndarray, "*s k"]) -> Float[np.ndarray, "*s k"]:
    """The coordinates theta of the gradient search at these shares of each parameter's range."""
    return np.log(shares / (1.0 - shares)) - space.origin


def origin_fractions(space: SearchSpace) -> Float[np.ndarray, " k"]:
    """The shares at theta = 0, where a gradient search starts."""
    return np.asarray(jax.nn.sigmoid(jnp.asarray(space.origin)))
