"""Gains within requirements: the objective and every requirement at a point, with what a Gauss-Newton step needs.

y -> controller -> scenarios -> signals -> objective, and requirements g(y) <= 0.
"""

from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.model.parameters import Scalar
from tuning.gains.objective import Objective
from tuning.gains.requirements import Constraints
from tuning.gains.scenarios import Ensemble, LoopSignals
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
    kept: ConstraintValues  # requirements by name; above zero where missed

    @property
    def missed(self) -> Scalar:
        """By how much the requirement that is missed most is missed; zero where all are kept."""
        return jnp.maximum(0.0, jnp.max(jnp.stack([jnp.max(values) for values in self.kept.values()])))

    @property
    def penalised(self) -> Scalar:
        """One number for searches that know no requirements: the objective, raised by what is missed.

        `DIVERGED_COST` and more where the loop diverges.
        """
        missed = sum(jnp.maximum(0.0, jnp.max(values)) for values in self.kept.values())
        number = self.objective * (1.0 + PENALTY * missed)
        known = jnp.isfinite(number) & (number < DIVERGED_COST)
        return jnp.where(
            known, number, DIVERGED_COST * (1.0 + jnp.nan_to_num(jnp.max(self.kept["stability"]), nan=1e3))
        )


class LinearisedPoint(NamedTuple):
    """A point with the derivatives of everything along the search vector."""

    point: DesignPoint
    slope: Float[Array, " k"]  # of the objective
    curvature: Float[Array, "k k"]  # Gauss-Newton: of the squares that have the objective's gradient here
    kept_slopes: dict[str, Float[Array, "n k"]]
    # mean products of a limited signal and its derivatives: its RMS is foretold as a root of a quadratic, not as a line
    products: dict[str, Float[Array, "lanes k1 k1"]]


@dataclass(frozen=True)
class ConstrainedGains:
    """The search as a function of y; hashed by value, so that the same question is compiled once."""

    free: tuple[FreeParameter, ...]
    objective: Objective

    def seen(self, y: Float[Array, " k"], problem: TuningProblem) -> tuple[LoopSignals, ConstraintValues]:
        controller = SearchSpace(self.free, problem.origin).insert(problem.controller, y)
        signals = problem.scenarios.signals(controller)
        return signals, problem.requirements.of_loop(controller) | problem.requirements.of_signals(signals)

    def at(self, y: Float[Array, " k"], problem: TuningProblem) -> DesignPoint:
        """The point's worth."""
        signals, kept = self.seen(y, problem)
        return DesignPoint(self.objective(signals), kept)

    def linearised(self, y: Float[Array, " k"], problem: TuningProblem) -> LinearisedPoint:
        """The point's worth with derivatives, in one forward pass for all parameters."""

        def along(
            direction: Array,
        ) -> tuple[tuple[LoopSignals, ConstraintValues], tuple[LoopSignals, ConstraintValues]]:
            return jax.jvp(lambda y: self.seen(y, problem), (y,), (direction,))

        (signals, kept), (slopes, kept_slopes) = jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(y)))
        weights = self.objective.weights(signals)
        root = [
            (weight * signal, weight * slope)
            for weight, signal, slope in zip(
                *(jax.tree.leaves(each) for each in (weights, signals, slopes)), strict=True
            )
        ]
        return LinearisedPoint(
            point=DesignPoint(self.objective(signals), kept),
            slope=sum(jnp.einsum("ln,kln->k", value, slope) for value, slope in root),
            curvature=sum(jnp.einsum("jln,kln->jk", slope, slope) for _, slope in root),
            kept_slopes={name: slope.T for name, slope in kept_slopes.items()},
            products=_products(problem.requirements, signals, slopes),
        )


def _products(
    requirements: Constraints, signals: LoopSignals, slopes: LoopSignals
) -> dict[str, Float[Array, "lanes i j"]]:
    values, derivatives = requirements.limited(signals), jax.vmap(requirements.limited)(slopes)
    both = {name: jnp.concatenate([values[name][None], derivatives[name]]) for name in values}
    return {name: jnp.einsum("iln,jln->lij", one, one) / one.shape[-1] for name, one in both.items()}


@eqx.filter_jit
def evaluate(gains: ConstrainedGains, y: Float[Array, " k"], problem: TuningProblem) -> DesignPoint:
    """`ConstrainedGains.at`, compiled."""
    return gains.at(y, problem)


@eqx.filter_jit
def linearise_at(gains: ConstrainedGains, y: Float[Array, " k"], problem: TuningProblem) -> LinearisedPoint:
    """`ConstrainedGains.linearised`, compiled."""
    return gains.linearised(y, problem)


def tuning_problem(
    controller: Controller, space: SearchSpace, scenarios: Ensemble, requirements: Constraints
) -> TuningProblem:
    """The problem of tuning `controller` (smooth, as arrays) in `space`."""
    return TuningProblem(controller, jnp.asarray(np.asarray(space.origin)), scenarios, requirements)
