"""The declaration of a parameter: its unit, its range and its meaning, stated once with the field, in `quantity(...)`.

The drive-file reader, the range checks and the reference table in the documentation are derived from that statement.
"""

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from diffdrive.errors import ParameterError
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.messages import short_repr
from diffdrive.support.typing import TomlTable
from diffdrive.support.units import in_unit

Parameters = TypeVar("Parameters", bound=eqx.Module)


class Quantity(NamedTuple):
    """Unit, range and meaning of one parameter."""

    unit: str
    meaning: str
    above: float | None
    at_least: float | None
    below: float | None
    at_most: float | None
    directional: bool
    optional: bool

    @property
    def range(self) -> tuple[float, float]:
        """The lowest and the highest value, inclusive or not."""
        lows = [bound for bound in (self.above, self.at_least) if bound is not None]
        highs = [bound for bound in (self.below, self.at_most) if bound is not None]
        return max(lows, default=-np.inf), min(highs, default=np.inf)

    def violated_bounds(self, numbers: np.ndarray | float) -> list[str]:
        """The bounds that some of these numbers violate, in words."""
        bounds = (
            ("above", self.above, np.greater),
            ("at least", self.at_least, np.greater_equal),
            ("below", self.below, np.less),
            ("at most", self.at_most, np.less_equal),
        )
        unit = "" if self.unit == "1" else f" {self.unit}"
        return [
            f"{word} {bound:g}{unit}"
            for word, bound, satisfies in bounds
            if bound is not None and not np.all(satisfies(numbers, bound))
        ]


class Directional(eqx.Module):
    """A parameter that differs between the directions of motion (paper, Tables 2 and 3)."""

    positive: Scalar
    negative: Scalar

    def towards(self, signal: Scalar) -> Scalar:
        """The value for the direction in which `signal` (a velocity, a bristle deflection) points; 0 counts as +."""
        return jnp.where(signal >= 0, self.positive, self.negative)

    def map(self, function: Callable[..., Scalar], *others: "Directional") -> "Directional":
        """The function of this and other parameters in each direction."""
        positive = function(self.positive, *(other.positive for other in others))
        return Directional(positive, function(self.negative, *(other.negative for other in others)))

    def __add__(self, other: "Directional | Scalar") -> "Directional":
        """The sum in each direction, with a pair or with one number for both."""
        positive, negative = (other.positive, other.negative) if isinstance(other, Directional) else (other, other)
        return Directional(self.positive + positive, self.negative + negative)


def directional(value: object) -> Directional | None:
    """One value for both directions, or a pair (positive, negative); None, where a parameter is absent, stays None."""
    if value is None or isinstance(value, Directional):
        return value
    if isinstance(value, list | tuple) or (isinstance(value, np.ndarray) and value.ndim == 1):
        if len(value) != 2:
            raise ParameterError(
                f"a value per direction needs exactly two entries [positive, negative], got {len(value)}: {value!r}"
            )
        return Directional(*value)
    return Directional(value, value)  # type: ignore[arg-type]  # `check` says what is no number


def is_number(value: object) -> bool:
    """Whether it is a number or an array of numbers, traced or not; a truth value is none."""
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        return bool(jnp.issubdtype(value.dtype, jnp.integer) or jnp.issubdtype(value.dtype, jnp.floating))
    return isinstance(value, int | float) and not isinstance(value, bool)


def parameter_value(name: str, declaration: Quantity | None, value: object) -> PyTree:
    """A value as the parameter `name` holds it: a number or an array, traced or not, or two for the two directions.

    None where the parameter is optional. Raises `ParameterError` for anything else; the range is not checked.
    """
    if declaration is not None and value is None and declaration.optional:
        return None
    held = directional(value) if declaration is not None and declaration.directional else value
    for direction, number in _by_direction(held):
        if not is_number(number):
            unit = "" if declaration is None else in_unit(declaration.unit)
            got = "a string" if isinstance(number, str) else short_repr(number)
            raise ParameterError(f"{name}{direction}: must be a number{unit}, got {got}")
    return held


def quantity(
    unit: str,
    meaning: str,
    *,
    above: float | None = None,
    at_least: float | None = None,
    below: float | None = None,
    at_most: float | None = None,
    per_direction: bool = False,
    default: object = dataclasses.MISSING,
    optional: bool = False,
) -> Any:
    """Declare a parameter field: its unit, meaning and range.

    `above` and `below` are exclusive, `at_least` and `at_most` inclusive, in the unit. A quantity may be None if its
    default is None or if it is `optional`. Drive files, sweeps and reports know a parameter by its declaration.

    Args:
        unit: Such as "N*s/m"; "1" for a ratio.
        meaning: What it is, in a few words.
        above: The largest value that is too small.
        at_least: The smallest value.
        below: The smallest value that is too large.
        at_most: The largest value.
        per_direction: Whether it may differ between the directions of motion: one number, or a pair.
        default: Its value where a file does not state it; without one, a file must.
        optional: Whether it may be None.

    Examples:
        >>> class Damper(Controller):
        ...     damping: float = quantity("N*s/m", "damping", at_least=0.0)

    """
    optional = optional or default is None
    meta = {"quantity": Quantity(unit, meaning, above, at_least, below, at_most, per_direction, optional)}
    options: dict[str, Any] = {"metadata": meta}
    if per_direction:
        options["converter"] = directional
        default = directional(default) if default not in (dataclasses.MISSING, None) else default
    if default is not dataclasses.MISSING:
        options["default"] = default
    return eqx.field(**options)


def quantities(module: eqx.Module, path: str = "") -> Iterator[tuple[str, Quantity, PyTree]]:
    """Every declared parameter below `module`: its dotted path, its declaration and its value."""
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        name = f"{path}.{field.name}" if path else field.name
        if "quantity" in field.metadata:
            yield name, field.metadata["quantity"], value
        elif isinstance(value, eqx.Module):
            yield from quantities(value, name)
        elif isinstance(value, tuple):
            for place, item in enumerate(value, 1):
                if isinstance(item, eqx.Module):
                    yield from quantities(item, f"{name}.{_item_name(item, place)}")


def _item_name(item: eqx.Module, place: int) -> str:
    """What a path calls one of several parts: its name, such as an effect's, or its place, from 1 on."""
    return str(getattr(item, "name", place))


def node_at(module: eqx.Module, path: str) -> PyTree:
    """What stands at a dotted path, as `quantities` has it.

    An effect by its name, a filter by its place (`filters.1`), a side of a pair by its field.
    """
    node: PyTree = module
    for part in path.split("."):
        if isinstance(node, tuple):
            node = next(item for place, item in enumerate(node, 1) if _item_name(item, place) == part)
        else:
            node = getattr(node, part)
    return node


def with_nodes(module: Parameters, values: Mapping[str, PyTree]) -> Parameters:
    """The same module with other values at these dotted paths."""
    return eqx.tree_at(
        lambda tree: [node_at(tree, path) for path in values],
        module,
        list(values.values()),
        is_leaf=lambda leaf: leaf is None,
    )


def _by_direction(value: object) -> Iterator[tuple[str, object]]:
    if isinstance(value, Directional):
        yield " (positive direction)", value.positive
        yield " (negative direction)", value.negative
    else:
        yield "", value


def _range_text(numbers: np.ndarray) -> str:
    """One number, or the range of several, as text."""
    low, high = float(np.min(numbers)), float(np.max(numbers))
    return f"{low:.6g} to {high:.6g}" if low < high else f"{low:.12g}"


def check(module: eqx.Module, path: str = "") -> None:
    """Raise `ParameterError` naming every parameter below `module` that is not finite or out of its range.

    Traced values (inside `jit`, `grad`, `vmap`) are skipped.
    """
    problems = []
    for name, declaration, value in quantities(module, path):
        if value is None and declaration.optional:
            continue
        for direction, number in _by_direction(value):
            if isinstance(number, jax.core.Tracer):
                continue
            if not is_number(number):
                problems.append(
                    f"{name}{direction} must be a number{in_unit(declaration.unit)}, got {short_repr(number)}"
                )
                continue
            try:
                numbers = np.asarray(number, dtype=float)
            except OverflowError:  # a whole number that no float holds
                problems.append(f"{name}{direction} must be finite, got {short_repr(number)}")
                continue
            if not np.all(np.isfinite(numbers)):
                problems.append(f"{name}{direction} must be finite, got {_range_text(numbers)}")
                continue
            problems += [
                f"{name}{direction} must be {bound}, got {_range_text(numbers)}"
                for bound in declaration.violated_bounds(numbers)
            ]
    if problems:
        raise ParameterError("; ".join(problems))


def quantity_table(module: eqx.Module) -> TomlTable:
    """The declared parameters of one module as TOML values; absent ones are left out."""
    table: TomlTable = {}
    for field in dataclasses.fields(module):
        value = getattr(module, field.name)
        if "quantity" not in field.metadata:
            continue
        if value is None:
            if field.default is not None:  # absent would mean the default
                table[field.name] = "none"
            continue
        if isinstance(value, Directional):
            pair = [float(value.positive), float(value.negative)]
            table[field.name] = pair[0] if pair[0] == pair[1] else pair
        else:
            table[field.name] = float(value)
    return table
