"""Derivative-free baselines of gain tuning, on the very ensemble, requirements, bounds and start of a gradient search.

    cma_es           covariance matrix adaptation (Hansen and Ostermeier 2001, in cma)
    nelder_mead      the simplex (Nelder and Mead 1965, in scipy)
    random_search    points drawn evenly

All share one interface: they begin at theta = 0, minimise one penalised number
(`tuning.gains.constrained.DesignPoint.penalised_objective`), keep to one budget, and return the best point in any case.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jax import lax
from jax.sharding import Mesh, PartitionSpec
from jaxtyping import Array, Float, Int

from tuning.gains.constrained import ConstrainedGains, TuningProblem
from tuning.gains.sequential import FEASIBILITY_TOLERANCE
from tuning.optimisation.evolution import DIVERGED_COST, Budget

INITIAL_SPREAD = 0.5  # in theta: the first spread of CMA-ES, the edges of the first simplex
MIN_SIMPLEX = 1e-4  # in theta: the size of a simplex that has collapsed
RANDOM_BATCH = 10  # points of random search at a time
BLOCK = 32  # points that one call of the compiled program holds at most

Points = Float[np.ndarray, "s k"]


class PenalisedCosts(NamedTuple):
    """What points of the search are worth, [s] each."""

    penalised_objective: Float[np.ndarray, " s"]  # what is minimised
    objective: Float[np.ndarray, " s"]
    violation: Float[np.ndarray, " s"]  # of the requirement that is violated most


CostFunction = Callable[[Points], PenalisedCosts]


class BaselineVisit(NamedTuple):
    """The lowest cost after so many simulations of the whole ensemble, and one more.

    It is as `tuning.optimisation.evolution.HistoryEntry`.
    """

    simulations: int
    seconds: float
    cost: float  # penalised
    feasible: float  # the lowest objective of a feasible point; infinite where there is none yet


OnVisit = Callable[[BaselineVisit], None]
NONE_YET = BaselineVisit(0, 0.0, np.inf, np.inf)


def silent(visit: BaselineVisit) -> None:
    """Show nothing."""


@dataclass(frozen=True)
class BaselineResult:
    """Where a baseline ended: its best point, why it stopped, and the lowest costs along the way."""

    theta: Float[np.ndarray, " k"]  # of the lowest penalised cost
    cost: float
    feasible: Float[np.ndarray, " k"] | None  # of the lowest objective among those that keep the requirements
    status: str
    history: list[BaselineVisit]  # batch by batch

    @property
    def simulations(self) -> int:
        """How many, of the whole ensemble."""
        return self.history[-1].simulations if self.history else 0


class _BudgetSpentError(Exception):
    """The budget is spent."""


@dataclass
class _Recorder:
    """The cost function as a search sees it: counts, keeps the best, and ends the search when its budget is spent."""

    cost: CostFunction
    budget: Budget
    on_visit: OnVisit
    theta: Float[np.ndarray, " k"]
    feasible: Float[np.ndarray, " k"] | None = None
    last: BaselineVisit = NONE_YET
    history: list[BaselineVisit] = field(default_factory=list)
    began: float = field(default_factory=time.perf_counter)

    def __call__(self, points: Points) -> Float[np.ndarray, " s"]:
        """Penalised costs, all of them finite. Of a batch that exceeds the budget only the first points are tried."""
        remaining = self.budget.simulations - self.last.simulations
        if remaining < 1:
            raise _BudgetSpentError(self._spent())
        points = points[:remaining]
        penalised, objective, missed = self.cost(points)
        penalised = np.where(np.isfinite(penalised), penalised, DIVERGED_COST)
        feasible = np.where(np.isfinite(objective) & (missed <= FEASIBILITY_TOLERANCE), objective, np.inf)
        self._keep(points, penalised, feasible)
        self.on_visit(self.last)
        if self._spent():
            raise _BudgetSpentError(self._spent())
        return penalised

    def _keep(self, points: Points, penalised: Float[np.ndarray, " s"], feasible: Float[np.ndarray, " s"]) -> None:
        least, best = int(np.argmin(penalised)), int(np.argmin(feasible))
        if penalised[least] < self.last.cost:
            self.theta = np.array(points[least])
        if feasible[best] < self.last.feasible:
            self.feasible = np.array(points[best])
        self.last = BaselineVisit(
            self.last.simulations + len(points),
            time.perf_counter() - self.began,
            min(self.last.cost, float(penalised[least])),
            min(self.last.feasible, float(feasible[best])),
        )
        self.history.append(self.last)

    def _spent(self) -> str:
        """Why the search must end; empty: it need not."""
        if self.last.cost <= self.budget.cost:
            return "good enough"
        if self.last.simulations >= self.budget.simulations:
            return f"stopped after {self.last.simulations} simulations"
        return f"stopped after {self.last.seconds:.0f} s" if self.last.seconds >= self.budget.seconds else ""


Evaluate = Callable[[Points], Float[np.ndarray, " s"]]


def _run_search(
    search: Callable[[Evaluate], str], cost: CostFunction, k: int, budget: Budget, on_visit: OnVisit
) -> BaselineResult:
    """The search, and what is left of it when it converges, has spent its budget or is interrupted."""
    recorder = _Recorder(cost, budget, on_visit, np.zeros(k))
    try:
        status = search(recorder)
    except _BudgetSpentError as spent:
        status = str(spent)
    except KeyboardInterrupt:
        status = f"interrupted after {recorder.last.simulations} simulations"
    return BaselineResult(recorder.theta, recorder.last.cost, recorder.feasible, status, recorder.history)


def cma_es(cost: CostFunction, k: int, budget: Budget, seed: int = 0, on_visit: OnVisit = silent) -> BaselineResult:
    """CMA-ES with the package's default population, 4 + 3 ln k, and its default rules of convergence."""

    def search(evaluate: Evaluate) -> str:
        import cma  # a second to load, and pyplot with it: only where it is used

        strategy = cma.CMAEvolutionStrategy(np.zeros(k), INITIAL_SPREAD, _quiet(seed))
        evaluate(np.zeros((1, k)))
        while not strategy.stop():
            points = strategy.ask()
            strategy.tell(points, list(evaluate(np.array(points))))
        return f"converged: {', '.join(strategy.stop())}"

    return _run_search(search, cost, k, budget, on_visit)


def _quiet(seed: int) -> dict[str, object]:
    """Options with which cma prints, reads and writes nothing, and draws from its own generator."""
    rng = np.random.default_rng(seed)
    # its option `seed` would seed numpy's global generator
    return {"verbose": -9, "signals_filename": "", "randn": lambda *shape: rng.standard_normal(shape), "seed": np.nan}


def nelder_mead(
    cost: CostFunction, k: int, budget: Budget, seed: int = 0, on_visit: OnVisit = silent
) -> BaselineResult:
    """Nelder-Mead. The first simplex has a corner in the start; `seed` draws whether its edges go up or down."""
    edges = INITIAL_SPREAD * np.random.default_rng(seed).choice([-1.0, 1.0], k)

    def search(evaluate: Evaluate) -> str:
        def cost_at(theta: Float[np.ndarray, " k"]) -> float:
            return float(evaluate(theta[None])[0])

        scipy.optimize.minimize(
            cost_at,
            np.zeros(k),
            method="Nelder-Mead",
            options={
                "initial_simplex": np.vstack([np.zeros(k), np.diag(edges)]),
                "xatol": MIN_SIMPLEX,
                "fatol": np.inf,  # the size of the simplex alone tells: costs have any scale
                "maxiter": budget.simulations + 1,  # never reached
                "maxfev": budget.simulations + 1,
            },
        )
        return "converged: the simplex has collapsed"

    return _run_search(search, cost, k, budget, on_visit)


def random_search(
    cost: CostFunction, k: int, budget: Budget, seed: int = 0, on_visit: OnVisit = silent
) -> BaselineResult:
    """The start and random points: even between the bounds where the start is in their middle (`space.around`).

    The sigmoid of a logistic variable is uniform.
    """
    rng = np.random.default_rng(seed)

    def search(evaluate: Evaluate) -> str:
        evaluate(np.zeros((1, k)))
        while True:
            evaluate(rng.logistic(size=(RANDOM_BATCH, k)))

    return _run_search(search, cost, k, budget, on_visit)


@eqx.filter_jit
def _block_costs(
    gains: ConstrainedGains,
    problem: TuningProblem,
    points: Float[Array, "b k"] | Float[np.ndarray, "b k"],
    counts: Int[Array, " devices"] | Int[np.ndarray, " devices"],
) -> Float[Array, "b three"]:
    """Of the points of each device the first `counts`: so one program serves batches of all sizes."""
    arrays, rest = eqx.partition(problem, eqx.is_array)

    def device_costs(
        points: Float[Array, "p k"] | Float[np.ndarray, "p k"],
        counts: Int[Array, " one"] | Int[np.ndarray, " one"],
        arrays: TuningProblem,
    ) -> Float[Array, "p three"]:
        problem = eqx.combine(arrays, rest)

        def evaluate_row(row: Int[Array, ""], costs: Float[Array, "p three"]) -> Float[Array, "p three"]:
            point = gains.evaluate(points[row], problem)
            return costs.at[row].set(jnp.stack([point.penalised_objective, point.objective, point.violation]))

        return lax.fori_loop(0, counts[0], evaluate_row, jnp.full((len(points), 3), jnp.nan))

    sharded, replicated = PartitionSpec("points"), PartitionSpec()  # type: ignore[no-untyped-call]  # jax declares no types of it
    return jax.shard_map(
        device_costs,
        mesh=Mesh(np.array(jax.devices()), ("points",)),
        in_specs=(sharded, sharded, replicated),
        out_specs=sharded,
        check_vma=False,
    )(points, counts, arrays)


def costs_of(gains: ConstrainedGains, problem: TuningProblem, block: int = BLOCK) -> CostFunction:
    """`ConstrainedGains.evaluate` for a batch of points, one after the other on each of the program's devices.

    Points side by side in one vectorised program, as in `tuning.optimisation.evolution`, are slower: the lanes of one
    ensemble fill the vectors already. With eight lanes on two cores: 25 ms per point, against 18 ms.
    """
    devices = len(jax.devices())
    rows = -(-block // devices)

    def block_costs(points: Points) -> Float[np.ndarray, "s three"]:
        """Point i goes to device i modulo devices."""
        counts = np.array([len(points[device::devices]) for device in range(devices)])
        padded = np.zeros((devices, rows, points.shape[1]))
        for device, count in enumerate(counts):
            padded[device, :count] = points[device::devices]
        costs = _block_costs(gains, problem, padded.reshape(devices * rows, -1), counts)
        return np.asarray(costs).reshape(devices, rows, 3).swapaxes(0, 1).reshape(-1, 3)[: len(points)]

    def cost(points: Points) -> PenalisedCosts:
        capacity = devices * rows
        costs = [block_costs(points[first : first + capacity]) for first in range(0, len(points), capacity)]
        return PenalisedCosts(*np.concatenate(costs).T)

    return cost
