"""optimistix's own solvers on gain tuning, with missed requirements as penalties: gradient baselines of the search.

    bfgs                  the penalised objective, a scalar
    levenberg_marquardt   squares that sum to the objective and the penalties

They see a requirement once it is missed; `tuning.gains.sequential` sees it before
(docs/evidence/tuning-study.md compares them).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from diffdrive.numerics.arrays import Scalar
from experiments.studies.tuning_study.baselines import BaselineResult, BaselineVisit
from tuning.gains.constrained import PENALTY, ConstrainedGains, DesignPoint, TuningProblem, evaluate
from tuning.gains.sequential import FEASIBILITY_TOLERANCE
from tuning.optimisation.evolution import Budget
from tuning.optimisation.least_squares import LevenbergMarquardt, Residuals, with_jacobian

TOLERANCE = 1e-6
NO_TAGS: frozenset[object] = frozenset()


@dataclass(frozen=True)
class _Scalar:
    """The penalised objective; hashed by value."""

    gains: ConstrainedGains

    def __call__(self, theta: Float[Array, " k"], problem: TuningProblem) -> Scalar:
        return self.gains.evaluate(theta, problem).penalised_objective


@dataclass(frozen=True)
class _Squares:
    """Residuals: signals, each sample weighed so that the squares sum to a mean of RMS values, and penalties."""

    gains: ConstrainedGains

    def __call__(self, theta: Float[Array, " k"], problem: TuningProblem) -> Float[Array, " m"]:
        signals, constraints = self.gains.signals_and_constraints(theta, problem)
        weights = jax.lax.stop_gradient(self.gains.objective.weights(signals))
        parts = jax.tree.map(lambda weight, signal: (weight * signal).ravel(), weights, signals)
        scale = jax.lax.stop_gradient(PENALTY * self.gains.objective(signals))
        violations = [
            jnp.sqrt(scale) * jnp.sqrt(jnp.maximum(jnp.max(values), 1e-12)) for values in constraints.values()
        ]
        return jnp.concatenate([*jax.tree.leaves(parts), jnp.stack(violations)])


_Cost = _Scalar | _Squares


def bfgs(gains: ConstrainedGains, problem: TuningProblem, budget: Budget) -> BaselineResult:
    """BFGS with Armijo's backtracking, from y = 0; an evaluation is a value with all its derivatives."""
    return _run_solver(optx.BFGS(rtol=TOLERANCE, atol=TOLERANCE), _Scalar(gains), gains, problem, budget)


def levenberg_marquardt(gains: ConstrainedGains, problem: TuningProblem, budget: Budget) -> BaselineResult:
    """Levenberg-Marquardt from y = 0; an evaluation is a value with all its derivatives."""
    return _run_solver(LevenbergMarquardt(rtol=TOLERANCE, atol=TOLERANCE), _Squares(gains), gains, problem, budget)


def _options(solver: Any) -> dict[str, object]:
    return {"autodiff_mode": "fwd"} if isinstance(solver, optx.BFGS) else {"jac": "fwd"}


def _function(residuals: _Cost) -> Callable[[Array, TuningProblem], tuple[Array, None]]:
    linearised = with_jacobian(cast(Residuals, residuals))
    return lambda theta, problem: (linearised(theta, problem), None)


@eqx.filter_jit
def _begin(solver: Any, residuals: _Cost, theta: Array, problem: TuningProblem) -> Any:
    fn = _function(residuals)
    shapes = eqx.filter_eval_shape(fn, theta, problem)
    return solver.init(fn, theta, problem, _options(solver), *shapes, NO_TAGS)


@eqx.filter_jit
def _step(solver: Any, residuals: _Cost, theta: Array, problem: TuningProblem, state: Any) -> Any:
    fn = _function(residuals)
    theta, state, _ = solver.step(fn, theta, problem, _options(solver), state, NO_TAGS)
    finished, _ = solver.terminate(fn, theta, problem, _options(solver), state, NO_TAGS)
    return theta, state, finished


def _run_solver(
    solver: Any, residuals: _Cost, gains: ConstrainedGains, problem: TuningProblem, budget: Budget
) -> BaselineResult:
    """Step by step, so that the budget is kept and the best point within the requirements is known."""
    theta = jnp.zeros(len(gains.free))
    state = _begin(solver, residuals, theta, problem)
    # compiled before the clock starts
    jax.block_until_ready(_step(solver, residuals, theta, problem, state))  # type: ignore[no-untyped-call]  # jax declares no types of it
    start, best, feasible = time.perf_counter(), (np.inf, np.asarray(theta)), np.inf
    feasible_theta: np.ndarray | None = None
    history: list[BaselineVisit] = []
    status = ""
    while not status:
        theta, state, finished = _step(solver, residuals, theta, problem, state)
        point: DesignPoint = evaluate(gains, theta, problem)
        penalised, objective = float(point.penalised_objective), float(point.objective)
        best = min(best, (penalised, np.asarray(theta)), key=lambda candidate: candidate[0])
        if float(point.violation) <= FEASIBILITY_TOLERANCE and objective < feasible:
            feasible, feasible_theta = objective, np.asarray(theta)
        history.append(BaselineVisit(len(history) + 1, time.perf_counter() - start, best[0], feasible))
        if bool(finished) or not np.isfinite(np.asarray(theta)).all():
            status = "converged" if bool(finished) else "diverged"
        elif len(history) >= budget.simulations:
            status = f"stopped after {len(history)} steps"
        elif history[-1].seconds >= budget.seconds:
            status = f"stopped after {history[-1].seconds:.0f} s"
    return BaselineResult(best[1], best[0], feasible_theta, status, history)
