"""Which parameters are free, and within which bounds: a search space beside the parameter tree, not inside it."""

from collections.abc import Sequence
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.errors import ParameterError
from diffdrive.model.quantity import Directional, node_at, quantities, with_nodes

Model = TypeVar("Model", bound=eqx.Module)


class FreeParameter(NamedTuple):
    """One free parameter: its dotted path in the tree, and the bounds it stays within.

    A path may end at a parameter per direction (both directions move together) or at its `positive` or `negative`.
    `low` above zero: it moves in its logarithm; otherwise linearly.
    """

    path: str
    low: float
    high: float

    @property
    def quantity(self) -> str:
        """The path of the parameter as it is declared, of which this may be one direction."""
        return self.path.removesuffix(".positive").removesuffix(".negative")


class Coordinate(NamedTuple):
    """How a free parameter moves, without how far: what a program is compiled for."""

    path: str
    logarithmic: bool


def coordinates(free: Sequence[FreeParameter]) -> tuple[Coordinate, ...]:
    """How each moves."""
    return tuple(Coordinate(one.path, one.low > 0) for one in free)


def bounds_of(free: Sequence[FreeParameter]) -> Float[np.ndarray, "2 k"]:
    """Where each stays, lowest and highest."""
    return np.array([[one.low for one in free], [one.high for one in free]])


class SearchSpace(NamedTuple):
    """Free parameters as one unbounded vector: theta = 0 is where each started, and no theta leaves the bounds.

    Gains are positive and span decades: each moves in its logarithm, through a sigmoid between its bounds.
    """

    free: tuple[FreeParameter, ...]
    origin: Float[np.ndarray, " k"] | Float[Array, " k"]

    @property
    def names(self) -> list[str]:
        """The last part of each path, with what it is the direction of."""
        return [_short(parameter.path) for parameter in self.free]

    def values(self, theta: Float[Array, " k"] | Float[np.ndarray, " k"]) -> Float[Array, " k"]:
        """The parameters at `theta`."""
        return values_at(theta + self.origin, coordinates(self.free), bounds_of(self.free))

    def insert(self, model: Model, theta: Float[Array, " k"] | Float[np.ndarray, " k"]) -> Model:
        """The model with its free parameters at `theta`."""
        return inserted(model, coordinates(self.free), self.values(theta))

    def near_bound(self, theta: Float[np.ndarray, " k"], within: float = 0.01) -> list[str]:
        """Paths of the parameters that ended within 1 % of their range from a bound."""
        return near_bound(coordinates(self.free), np.asarray(theta + self.origin), within)


def values_at(
    place: Float[Array, " k"] | Float[np.ndarray, " k"],
    free: Sequence[Coordinate],
    bounds: Float[Array, "2 k"] | Float[np.ndarray, "2 k"],
) -> Float[Array, " k"]:
    """Parameters between their bounds, from the unbounded place of each."""
    share, (lowest, highest) = jax.nn.sigmoid(jnp.asarray(place)), bounds
    found = [
        low * jnp.exp(jnp.log(high / low) * s) if one.logarithmic else low + (high - low) * s
        for one, low, high, s in zip(free, lowest, highest, share, strict=True)
    ]
    return jnp.stack(found)


def inserted(model: Model, free: Sequence[Coordinate], values: Float[Array, " k"]) -> Model:
    """The model with these values of its free parameters."""
    new = {}
    for one, value in zip(free, values, strict=True):
        is_pair = isinstance(node_at(model, one.path), Directional)
        new[one.path] = Directional(value, value) if is_pair else value
    return with_nodes(model, new)


def near_bound(free: Sequence[Coordinate], place: Float[np.ndarray, " k"], within: float = 0.01) -> list[str]:
    """Paths of the parameters that are within 1 % of their range from a bound."""
    share = np.asarray(jax.nn.sigmoid(jnp.asarray(place)))
    return [one.path for one, s in zip(free, share, strict=True) if s < within or s > 1 - within]


def _short(path: str) -> str:
    parts = path.split(".")
    return ".".join(parts[-2:] if parts[-1] in ("positive", "negative") else parts[-1:])


def _value(model: eqx.Module, path: str) -> float:
    node = node_at(model, path)
    if not isinstance(node, Directional):
        return float(node)
    if float(node.positive) != float(node.negative):
        raise ParameterError(
            f"'{path}' differs between the directions: free '{path}.positive' and '{path}.negative' in its place"
        )
    return float(node.positive)


def search_space(model: eqx.Module, bounds: Sequence[FreeParameter]) -> SearchSpace:
    """The space of these free parameters, started where `model` has them."""
    known = {name for name, *_ in quantities(model)}
    origin = []
    for bound in bounds:
        path, low, high = bound
        if bound.quantity not in known:
            raise ParameterError(f"no parameter '{path}' here; known: {', '.join(sorted(known))}")
        value = _value(model, path)
        if not low < value < high:
            raise ParameterError(
                f"'{path}' starts at {value:g}, which is not inside its bounds {low:g} to {high:g}: widen them"
            )
        share = np.log(value / low) / np.log(high / low) if low > 0 else (value - low) / (high - low)
        origin.append(np.log(share / (1 - share)))
    return SearchSpace(tuple(bounds), np.array(origin))


def space_around(model: eqx.Module, factors: dict[str, float]) -> SearchSpace:
    """A space in which each named parameter may move by its factor, up or down; those that are zero stay."""
    values = {path: _value(model, path) for path in factors}
    return search_space(
        model, [FreeParameter(path, v / factors[path], v * factors[path]) for path, v in values.items() if v > 0]
    )
