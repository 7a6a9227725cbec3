"""Gains within requirements: the objective and every requirement at a point, with what a Gauss-Newton step needs.

theta -> controller -> scenarios -> signals -> objective, and requirements g(theta) <= 0.
"""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.numerics.arrays import Scalar
from tuning.gains.objective import Objective
from tuning.gains.requirements import Constraints
from tuning.gains.scenarios import Ensemble, EnsembleSignals
from tuning.optimisation.space import FreeParameter, SearchSpace

PENALTY, DIVERGED_COST = 10.0, 1e6

ConstraintValues = dict[str, Float[Array, " n"]]


class TuningProblem(NamedTuple):
    """The controller to tune (smooth, every number an array), where it is tried, and what it must keep."""

    controller: Controller
    origin: Float[Array, " k"]  # of the search space
    scenarios: Ensemble
    requirements: Constraints


class DesignPoint(NamedTuple):
    """What a point of the search is worth."""

    objective: Scalar
    constraints: ConstraintValues  # requirements by name; above zero where missed

    @property
    def violation(self) -> Scalar:
        """By how much the requirement that is missed most is missed; zero where all are kept."""
        return jnp.maximum(0.0, jnp.max(jnp.stack([jnp.max(values) for values in self.constraints.values()])))

    @property
    def penalised_objective(self) -> Scalar:
        """One number for searches that know no requirements: the objective, raised by what is missed.

        `DIVERGED_COST` and more where the loop diverges.
        """
        violation = sum(jnp.maximum(0.0, jnp.max(values)) for values in self.constraints.values())
        number = self.objective * (1.0 + PENALTY * violation)
        finite = jnp.isfinite(number) & (number < DIVERGED_COST)
        return jnp.where(
            finite, number, DIVERGED_COST * (1.0 + jnp.nan_to_num(jnp.max(self.constraints["stability"]), nan=1e3))
        )


class LinearisedPoint(NamedTuple):
    """A point with the derivatives of everything along the search vector."""

    point: DesignPoint
    gradient: Float[Array, " k"]  # of the objective
    hessian: Float[Array, "k k"]  # Gauss-Newton: of the squares that have the objective's gradient here
    constraint_jacobians: dict[str, Float[Array, "n k"]]
    # mean products of a limited signal and its derivatives: its RMS is predicted as a root of a quadratic, not a line
    products: dict[str, Float[Array, "lanes k1 k1"]]


@dataclass(frozen=True)
class ConstrainedGains:
    """The search as a function of theta; hashed by value, so that the same question is compiled once."""

    free: tuple[FreeParameter, ...]
    objective: Objective

    def signals_and_constraints(
        self, theta: Float[Array, " k"], problem: TuningProblem
    ) -> tuple[EnsembleSignals, ConstraintValues]:
        controller = SearchSpace(self.free, problem.origin).insert(problem.controller, theta)
        signals = problem.scenarios.signals(controller)
        return signals, problem.requirements.loop_constraints(controller) | problem.requirements.signal_constraints(
            signals
        )

    def evaluate(self, theta: Float[Array, " k"], problem: TuningProblem) -> DesignPoint:
        """The point's worth."""
        signals, constraints = self.signals_and_constraints(theta, problem)
        return DesignPoint(self.objective(signals), constraints)

    def linearised(self, theta: Float[Array, " k"], problem: TuningProblem) -> LinearisedPoint:
        """The point's worth with derivatives, in one forward pass for all parameters."""

        def along(
            direction: Array,
        ) -> tuple[tuple[EnsembleSignals, ConstraintValues], tuple[EnsembleSignals, ConstraintValues]]:
            return jax.jvp(lambda theta: self.signals_and_constraints(theta, problem), (theta,), (direction,))

        (signals, constraints), (slopes, jacobians) = jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(theta)))
        weights = self.objective.weights(signals)
        root = [
            (weight * signal, weight * slope)
            for weight, signal, slope in zip(
                *(jax.tree.leaves(each) for each in (weights, signals, slopes)), strict=True
            )
        ]
        return LinearisedPoint(
            point=DesignPoint(self.objective(signals), constraints),
            gradient=jnp.asarray(sum(jnp.einsum("ln,kln->k", value, slope) for value, slope in root)),
            hessian=jnp.asarray(sum(jnp.einsum("jln,kln->jk", slope, slope) for _, slope in root)),
            constraint_jacobians={name: slope.T for name, slope in jacobians.items()},
            products=_products(problem.requirements, signals, slopes),
        )


def _products(
    requirements: Constraints, signals: EnsembleSignals, slopes: EnsembleSignals
) -> dict[str, Float[Array, "lanes i j"]]:
    values, derivatives = requirements.limited_signals(signals), jax.vmap(requirements.limited_signals)(slopes)
    both = {name: jnp.concatenate([values[name][None], derivatives[name]]) for name in values}
    return {name: jnp.einsum("iln,jln->lij", signal, signal) / signal.shape[-1] for name, signal in both.items()}


@eqx.filter_jit
def evaluate(gains: ConstrainedGains, theta: Float[Array, " k"], problem: TuningProblem) -> DesignPoint:
    """`ConstrainedGains.evaluate`, compiled."""
    return gains.evaluate(theta, problem)


@eqx.filter_jit
def linearise_at(gains: ConstrainedGains, theta: Float[Array, " k"], problem: TuningProblem) -> LinearisedPoint:
    """`ConstrainedGains.linearised`, compiled."""
    return gains.linearised(theta, problem)


def tuning_problem(
    controller: Controller, space: SearchSpace, scenarios: Ensemble, requirements: Constraints
) -> TuningProblem:
    """The problem of tuning `controller` (smooth, as arrays) in `space`."""
    return TuningProblem(controller, jnp.asarray(np.asarray(space.origin)), scenarios, requirements)
