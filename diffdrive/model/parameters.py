"""The parameters of a drive: plant, friction, actuator, sensor, as pytrees in SI units.

Each field states its unit, its range and its meaning once, in `quantity(...)`. The drive-file reader, the range checks
and the reference table in the documentation are derived from that statement.
"""

import dataclasses
import math
from collections.abc import Iterator
from typing import Any, NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from diffdrive.errors import ParameterError, PrecisionError
from diffdrive.support.messages import short_repr
from diffdrive.support.typing import TomlTable
from diffdrive.support.units import in_unit

LONGEST_SUBSTEP, SUBSTEP_ERROR = 20e-6, 1e-10  # s, and the position error of the plant's integrator there, m
# s: the integrator is of second order, and here its error is the rounding of a position of a metre
FINEST_SUBSTEP = LONGEST_SUBSTEP * float(np.sqrt(np.finfo(float).eps / SUBSTEP_ERROR))
LIMIT_ROUNDING = 0.01  # of the force limit, in the smooth variant
ROUNDING = 1e-6  # largest rounding error of a smoothed limit, as a share of its width
Scalar = Float[Array, ""] | float | int  # a check at run time does not take an int for a float
Tree = TypeVar("Tree")


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


class Plant(eqx.Module):
    """M_S a + B_S v = u + constant_force - F(v, z)  (paper, eq. (7), and a constant force beside it)."""

    mass: Scalar = quantity("kg", "moving mass, motor and screw inertia included", above=0.0)
    damping: Directional = quantity("N*s/m", "viscous damping of the system", at_least=0.0, per_direction=True)
    constant_force: Scalar = quantity("N", "inclined axis, counterbalance or amplifier offset", default=0.0)


class Friction(eqx.Module):
    """LuGre friction with load-dependent Coulomb friction, per direction (paper, eqs. (4) to (6))."""

    coulomb_screw: Directional = quantity("N", "Coulomb friction of the screw, F_BC", at_least=0.0, per_direction=True)
    load_coefficient: Directional = quantity(
        "1", "Coulomb friction coefficient of the guides, mu_LC", at_least=0.0, per_direction=True
    )
    initial_load: Scalar = quantity("N", "load on the guides from preload and table, W_LI", at_least=0.0)
    breakaway_gap: Directional = quantity(
        "N",
        "breakaway minus Coulomb friction, F_S - F_C; negative where friction rises from standstill",
        per_direction=True,
    )
    stribeck_velocity: Directional = quantity("m/s", "Stribeck velocity, v_s", above=0.0, per_direction=True)
    viscous: Directional = quantity("N*s/m", "viscous friction, mu_v", at_least=0.0, per_direction=True)
    bristle_stiffness: Directional = quantity("N/m", "bristle stiffness, sigma_0", above=0.0, per_direction=True)
    bristle_damping: Directional = quantity("N*s/m", "bristle damping, sigma_1", at_least=0.0, per_direction=True)
    stribeck_exponent: Scalar | None = quantity(
        "1",
        "exponent d of the Stribeck curve, exp(-(abs(v) / v_s)^d); absent: 1",
        at_least=0.1,
        at_most=4.0,
        default=None,
    )

    @property
    def exponent(self) -> Scalar:
        """The exponent of the Stribeck curve; the paper's is 1."""
        return 1.0 if self.stribeck_exponent is None else self.stribeck_exponent


class Actuator(eqx.Module):
    """Force limit and delay between the command and the force on the table.

    The delay is `delay_samples` control periods (static: the length of the pipeline) and `delay_fraction` of one.
    """

    force_limit: Scalar | None = quantity(
        "N", "largest force in either direction; absent: unlimited", above=0.0, default=None
    )
    limit_rounding: Scalar | None = quantity(
        "N",
        "width over which the smooth variant rounds the limit; absent: the exact, hard limit",
        above=0.0,
        default=None,
    )
    delay_samples: int = eqx.field(static=True, default=0)
    delay_fraction: Scalar | None = quantity(
        "1", "further delay as a share of the control period, 0 to 1", at_least=0.0, default=None
    )

    @property
    def pipelines(self) -> tuple[tuple[str, int], ...]:
        """Delay lines: the name of each, and its length in samples."""
        return (("actuator.delay_samples", self.delay_samples),)

    def smoothed(self) -> "Actuator":
        """The smooth variant: the corners of the limit rounded."""
        if self.force_limit is None:
            return self
        return dataclasses.replace(self, limit_rounding=LIMIT_ROUNDING * self.force_limit)


class Sensor(eqx.Module):
    """Linear scale at the table: white noise, then quantisation."""

    resolution: Scalar | None = quantity(
        "m", "step of the measured position; absent: no quantisation", above=0.0, default=None
    )
    noise: Scalar = quantity(
        "m", "standard deviation of the white noise before the quantiser", at_least=0.0, default=0.0
    )

    def smoothed(self) -> "Sensor":
        """The smooth variant: no quantiser."""
        return Sensor(resolution=None, noise=self.noise)


class Drive(eqx.Module):
    """The machine: everything between the force command and the measured position."""

    plant: Plant
    friction: Friction
    actuator: Actuator = Actuator()
    sensor: Sensor = Sensor()
    effects: tuple[PyTree, ...] = ()  # of the catalogue (diffdrive.effects)


class Sampling(eqx.Module):
    """Control rate, and plant substeps in each control period (`None`: as many as keep a substep within 20 us).

    At that substep the integrator's position error is 0.1 nm or less on the paper's drive at 10 kHz, and of that order
    on others (docs/method/numerics.md). No substep may be shorter than `FINEST_SUBSTEP`.
    """

    rate: float = eqx.field(static=True, default=10_000.0)
    substeps: int | None = eqx.field(static=True, default=None)

    def __check_init__(self) -> None:
        if not (isinstance(self.rate, int | float | np.number) and 10.0 <= self.rate <= 1e6):
            raise ParameterError(f"sampling.rate must lie between 10 and 1e6 Hz, got {short_repr(self.rate)}")
        is_whole = isinstance(self.substeps, int) and not isinstance(self.substeps, bool)
        if self.substeps is None:
            return
        if not (is_whole and self.substeps >= 1):
            raise ParameterError(
                f"sampling.substeps must be a whole number of at least 1, got {short_repr(self.substeps)}"
            )
        most = math.ceil(self.period / FINEST_SUBSTEP)
        if self.substeps > most:
            raise ParameterError(
                f"sampling.substeps must be at most {most} at {self.rate:g} Hz, got {short_repr(self.substeps)}: finer "
                "substeps gain nothing, since their error is below the last digit of a position"
            )

    @property
    def period(self) -> float:
        """Seconds from one control step to the next."""
        return 1.0 / self.rate

    @property
    def plant_steps(self) -> int:
        """Substeps of the plant in one control period."""
        return self.substeps or int(np.ceil(round(self.period / LONGEST_SUBSTEP, 6)))


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
            for item in value:
                if isinstance(item, eqx.Module):
                    yield from quantities(item, f"{name}.{getattr(item, 'name', type(item).__name__)}")


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


def check_drive(drive: Drive) -> None:
    """`check`, and the conditions that concern several parameters."""
    check(drive)
    delay = drive.actuator.delay_samples
    if not isinstance(delay, int) or delay < 0:
        raise ParameterError(
            f"actuator.delay_samples must be a whole number of samples, 0 or more, got {short_repr(delay)}"
        )
    fraction = drive.actuator.delay_fraction
    if fraction is not None and not isinstance(fraction, jax.core.Tracer) and not np.all(np.asarray(fraction) <= 1):
        raise ParameterError(
            f"actuator.delay_fraction must be at most 1, got {fraction!r}: whole periods belong into delay_samples"
        )
    limit, width = drive.actuator.force_limit, drive.actuator.limit_rounding
    # the rounded limit is a difference of numbers as large as the limit
    if (
        limit is not None
        and width is not None
        and not any(isinstance(x, jax.core.Tracer) for x in (limit, width))
        and np.any(np.finfo(float).eps * np.asarray(limit) > ROUNDING * np.asarray(width))
    ):
        raise ParameterError(
            f"actuator.limit_rounding of {np.min(width):g} N is lost in the rounding of the force limit of "
            f"{np.max(limit):g} N: check the units of both, or leave out limit_rounding"
        )
    friction = drive.friction
    for side in ("positive", "negative"):
        level = getattr(friction.coulomb_screw, side) + getattr(friction.load_coefficient, side) * friction.initial_load
        breakaway = level + getattr(friction.breakaway_gap, side)
        if not isinstance(level, jax.core.Tracer) and not np.all(np.asarray(level) > 0):
            raise ParameterError(
                f"friction: the Coulomb friction in the {side} direction is zero (coulomb_screw + load_coefficient * "
                "initial_load); LuGre friction needs a positive one: give at least a small coulomb_screw"
            )
        if not isinstance(breakaway, jax.core.Tracer) and not np.all(np.asarray(breakaway) > 0):
            raise ParameterError(
                f"friction.breakaway_gap in the {side} direction makes the breakaway friction "
                f"{float(np.min(breakaway)):g} N (coulomb_screw + load_coefficient * initial_load + breakaway_gap): it "
                "must stay positive"
            )


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


def require_double_precision() -> None:
    """Raise `PrecisionError` unless JAX computes in double precision."""
    if not jax.config.jax_enable_x64:
        raise PrecisionError(
            "diffdrive needs double precision, which JAX leaves off by default: run "
            "`jax.config.update('jax_enable_x64', True)` before the first computation (the command line and "
            "`diffdrive.runtime.configure()` do it for you)"
        )


def as_arrays(tree: Tree) -> Tree:
    """The same tree with every number as a double-precision array, so that a new value never recompiles."""

    def convert(leaf: PyTree) -> PyTree:
        if isinstance(leaf, bool) or not isinstance(leaf, int | float | np.number | np.ndarray | jax.Array):
            return leaf
        return jnp.asarray(leaf, dtype=jnp.float64)

    return jax.tree.map(convert, tree)


def in_precision_of(number: Scalar, tree: Tree) -> Tree:
    """The same tree with every array of floats in the precision of `number`."""
    dtype = jnp.result_type(number)

    def convert(leaf: PyTree) -> PyTree:
        return leaf.astype(dtype) if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(convert, tree)
