"""What two identifications of one axis say of its change: the estimates that both sets of logs determine, side by side.

Both fits are those with every parameter free: what a set hardly determines is then as uncertain as it is, and so is
what hangs together with it. Positive parameters are compared by their logarithms, as they are searched.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from tuning.comparison.changes import Difference, Estimates
from tuning.identification.identify import UNDETERMINED, Identification
from tuning.identification.parameters import axis_path, parameter_at, without_side
from tuning.identification.refinement import leading_innovation
from tuning.identification.uncertainty import repetition_inflation
from tuning.identification.unknowns import Unknowns, value_at
from tuning.optimisation.space import near_bound


class Component(NamedTuple):
    """One estimate that is compared: a parameter, or one direction of it."""

    path: str  # in an axis
    unit: str
    is_relative: bool  # compared by its logarithm
    values: tuple[float, float]  # before and after, in its unit

    @property
    def parameter(self) -> str:
        """The path without the direction."""
        return without_side(self.path)

    @property
    def name(self) -> str:
        """The path without the part of the axis."""
        return self.path.partition(".")[2]


class MachineDifference(NamedTuple):
    """What both sets determine, and the paths of what one of them leaves open."""

    components: tuple[Component, ...]
    difference: Difference | None  # of the components; None where there is none
    undetermined: tuple[str, ...]


def answer(found: Identification) -> Unknowns:
    """Where the fit with every parameter free has ended."""
    fit = found.full_fit
    return jax.tree.map(float, fit.residuals.unpack(jnp.asarray(fit.search.theta), fit.problem)[1])


def machine_difference(before: Identification, after: Identification) -> MachineDifference:
    """The estimates of two fits that began with the same axis."""
    sides = before, after
    free = [{one.path for one in side.full_fit.residuals.free} for side in sides]
    every = [one.path for one in before.full_fit.residuals.free if one.path in free[1]]
    weak = _weak(before) | _weak(after)
    paths = [path for path in every if path not in weak]
    undetermined = tuple(axis_path(path) for path in sorted((free[0] | free[1]) - set(paths)))
    if not paths:
        return MachineDifference((), None, undetermined)
    estimated = [_estimates(side, paths) for side in sides]
    components = tuple(
        Component(axis_path(path), parameter_at(axis_path(path)).unit, _is_relative(path), (one, other))
        for path, one, other in zip(
            paths, *([_value(answer(side), path) for path in paths] for side in sides), strict=True
        )
    )
    difference = Difference(tuple(one.parameter for one in components), *estimated)
    return MachineDifference(components, difference, undetermined)


def _weak(found: Identification) -> set[str]:
    """What the logs hardly narrow, or push against its bound, where the search vector has no more effect."""
    fit = found.full_fit
    errors = fit.problem.prior * np.sqrt(np.diag(fit.covariance.matrix))
    weak = {one.path for one, error in zip(fit.residuals.free, errors, strict=True) if not 0 < error <= UNDETERMINED}
    return weak | set(near_bound(fit.residuals.free, fit.search.theta + fit.problem.origin))


def _is_relative(path: str) -> bool:
    return not parameter_at(axis_path(path)).is_signed


def _value(unknowns: Unknowns, path: str) -> float:
    """In the unit of the parameter: the gap F_S - F_C, as a drive file has it, in the place of the ratio."""
    field, _, side = path.partition(".")
    if field != "breakaway":
        return value_at(unknowns, path)
    return value_at(unknowns, f"coulomb.{side}") * (value_at(unknowns, path) - 1.0)


def _estimates(found: Identification, paths: Sequence[str]) -> Estimates:
    """The compared numbers of one fit, with the covariance of laps that are no new ones."""
    fit = found.full_fit

    def compared(theta: Float[Array, " k"]) -> Float[Array, " m"]:
        _, unknowns = fit.residuals.unpack(theta, fit.problem)
        return jnp.stack([_compared(unknowns, path) for path in paths])

    theta = jnp.asarray(fit.search.theta)
    slope = np.asarray(jax.jacfwd(compared)(theta))
    innovation, expected = leading_innovation(fit)
    again = repetition_inflation(innovation / expected, fit.residuals.sampling.rate)
    # the scores of the blocks sum to zero; what the parameters take of them, the covariance allows for (`sandwich`)
    freedom = max(3.0, fit.covariance.blocks - 1.0)
    return Estimates(np.asarray(compared(theta)), again * slope @ fit.covariance.matrix @ slope.T, freedom)


def _compared(unknowns: Unknowns, path: str) -> Array:
    field, dot, side = path.partition(".")
    node = getattr(unknowns, field)
    number = getattr(node, side) if dot else getattr(node, "positive", node)
    if field == "breakaway":
        return jnp.asarray(getattr(unknowns.coulomb, side) * (number - 1.0))
    return jnp.log(number) if _is_relative(path) else jnp.asarray(number)
