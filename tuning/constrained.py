"""Gains within requirements, by least squares: an augmented Lagrangian around Levenberg-Marquardt.

    minimise  objective(signals(y))   subject to   g(y) <= 0

One round minimises the objective, written as a sum of squares about the point at hand (tuning.objective), plus
mu/2 max(0, g + lambda/mu)^2 for each requirement; after it the multipliers become max(0, lambda + mu g) (Hestenes 1969,
Powell 1969, Rockafellar 1973). The multipliers say what each requirement costs.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.parameters import Scalar
from tuning.objective import Objective
from tuning.requirements import Requirements
from tuning.scenarios import Ensemble, Signals
from tuning.space import Free, Space

PENALTY, HOPELESS = 10.0, 1e6

Named = dict[str, Float[Array, " n"]]


class Problem(NamedTuple):
    """The controller to tune (smooth, every number an array), where it is tried, and what it must keep."""

    controller: Controller
    origin: Float[np.ndarray, " k"]  # of the search space
    scenarios: Ensemble
    requirements: Requirements


class Priced(NamedTuple):
    """A problem with the weights of the squares and the prices of the requirements for one round."""

    problem: Problem
    weights: Signals
    multipliers: Named
    stiffness: Scalar  # mu


class Point(NamedTuple):
    """What a point of the search is worth."""

    objective: Scalar
    kept: Named  # requirements by name; above zero where missed
    weights: Signals

    @property
    def missed(self) -> Scalar:
        """By how much the requirement that is missed most is missed; zero where all are kept."""
        return jnp.maximum(0.0, jnp.max(jnp.stack([jnp.max(values) for values in self.kept.values()])))

    @property
    def penalised(self) -> Scalar:
        """One number for searches that know no requirements: the objective, raised by what is missed.

        `HOPELESS` and more where the loop diverges.
        """
        missed = sum(jnp.maximum(0.0, jnp.max(values)) for values in self.kept.values())
        number = self.objective * (1.0 + PENALTY * missed)
        known = jnp.isfinite(number) & (number < HOPELESS)
        return jnp.where(known, number, HOPELESS * (1.0 + jnp.nan_to_num(jnp.max(self.kept["stability"]), nan=1e3)))


@dataclass(frozen=True)
class Gains:
    """The search as a function of y; hashed by value, so that the same question is compiled once."""

    free: tuple[Free, ...]
    objective: Objective

    def controller(self, y: Float[Array, " k"], problem: Problem) -> Controller:
        """The controller at y."""
        return Space(self.free, problem.origin).insert(problem.controller, y)

    def requirements(self, controller: Controller, signals: Signals, problem: Problem) -> Named:
        """All requirements by name."""
        return problem.requirements.of_loop(controller) | problem.requirements.of_signals(signals)

    def __call__(self, y: Float[Array, " k"], priced: Priced) -> Float[Array, " m"]:
        """Residuals of one round."""
        controller = self.controller(y, priced.problem)
        signals = priced.problem.scenarios.signals(controller)
        kept = self.requirements(controller, signals, priced.problem)
        squares = jax.tree.leaves(jax.tree.map(lambda weight, signal: weight * signal, priced.weights, signals))
        return jnp.concatenate([part.ravel() for part in (*squares, *_penalties(kept, priced))])

    def at(self, y: Float[Array, " k"], problem: Problem) -> Point:
        """The point's worth."""
        controller = self.controller(y, problem)
        signals = problem.scenarios.signals(controller)
        kept = self.requirements(controller, signals, problem)
        return Point(self.objective(signals), kept, self.objective.weights(signals))


@dataclass(frozen=True)
class Stability:
    """Residuals of the requirements on the loop alone, for a start that does not keep them; hashed by value."""

    free: tuple[Free, ...]

    def __call__(self, y: Float[Array, " k"], problem: Problem) -> Float[Array, " m"]:
        """How far each is missed, and a little of the distance to the start."""
        kept = problem.requirements.of_loop(Space(self.free, problem.origin).insert(problem.controller, y))
        missed = [jnp.maximum(values + ROOM, 0.0) for values in kept.values()]
        return jnp.concatenate([*missed, NEARNESS * y])


ROOM, NEARNESS = 0.1, 1e-3  # of the requirement, and per unit of y


def _penalties(kept: Named, priced: Priced) -> list[Array]:
    stiffness = priced.stiffness
    return [
        jnp.sqrt(stiffness) * jnp.maximum(values + priced.multipliers[name] / stiffness, 0.0)
        for name, values in kept.items()
    ]


@eqx.filter_jit
def worth(gains: Gains, y: Float[Array, " k"], problem: Problem) -> Point:
    """`Gains.at`, compiled."""
    return gains.at(y, problem)


class Round(NamedTuple):
    """Where the search stands after a round, all that it needs to go on."""

    number: int
    y: Float[np.ndarray, " k"]
    multipliers: dict[str, Float[np.ndarray, " n"]]
    history: tuple[tuple[int, float, float, float], ...]  # evaluations, s, objective, missed; one for each round


Keep = Callable[[Round], None]
