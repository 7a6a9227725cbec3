"""The arithmetic of a controller's step, from the JAX program that is simulated.

The step is traced as `simulate` runs it, and each of its primitive operations becomes a `Value` (`primitives.py`), so
that a target gives the same to the last bits.
"""

import re
from collections.abc import Callable, Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from diffdrive.controllers import Controller, Reference
from diffdrive.controllers.base import Encoders
from diffdrive.model.friction import resolvable
from diffdrive.model.memory import memories
from diffdrive.model.quantity import Directional, quantities, with_nodes
from diffdrive.numerics.arrays import in_precision_of, require_double_precision
from experiments.exports.names import ends_of, identifiers
from experiments.exports.primitives import evaluated, kind_of, size_of
from experiments.exports.program import Arithmetic, ExportError, Kind, Parameter, Program, Signal, State

REFERENCE = (
    Signal("reference_position", "m", "reference position"),
    Signal("reference_velocity", "m/s", "reference velocity"),
    Signal("reference_acceleration", "m/s^2", "reference acceleration"),
)
SCALE = Signal("scale_position", "m", "measured position of the table")
MOTOR = Signal("motor_position", "m", "measured position of the motor, as travel of the table")
ENCODERS = {"scale": SCALE, "motor": MOTOR}
APPLIED = Signal("applied_force", "N", "force that acted since the last step: measured, or the last command that acts")
FORCE = Signal("force", "N", "force command")
ESTIMATES = {
    "friction": Signal("friction_estimate", "N", "estimated friction, without viscous damping"),
    "load": Signal("load_estimate", "N", "estimated load on the guides"),
    "velocity": Signal("velocity_estimate", "m/s", "estimated velocity of the table"),
    "innovation": Signal("innovation", "m", "measured minus predicted position"),
}


def program_of(controller: Controller, period: float, name: str, *, single: bool = False) -> Program:
    """The program of a controller that runs each `period` (s).

    Args:
        controller: Of any kind whose law is known.
        period: Control period (s), which is part of the code.
        name: What begins each of its names.
        single: Whether it is to be computed in single precision.

    Raises:
        ExportError: Its law is unknown, or it uses what no target has.

    """
    require_double_precision()
    if not controller.can_simulate:
        raise ExportError("the drive file's controller is 'unknown': give [controller] a kind and its gains")
    parameters, with_values = _parameters(controller)
    number = jax.ShapeDtypeStruct((), jnp.float32 if single else jnp.float64)  # type: ignore[no-untyped-call]
    encoders = [signal for name, signal in ENCODERS.items() if name in controller.feedback_encoders]
    inputs = (*REFERENCE, *encoders, APPLIED)

    def start(values: Sequence[jax.Array], position: jax.Array) -> PyTree:
        return in_precision_of(position, with_values(values).init(position))

    def step(values: Sequence[jax.Array], state: PyTree, signals: Sequence[jax.Array]) -> PyTree:
        given = dict(zip((one.name for one in inputs), signals, strict=True))
        # without a scale among the inputs it is not read
        measured = Encoders(given.get(SCALE.name, given[APPLIED.name]), given.get(MOTOR.name))
        controller, applied = with_values(values), given[APPLIED.name]
        following, command = controller.step_from_encoders(state, Reference(*signals[:3]), measured, applied, period)
        estimates = {} if command.estimate is None else command.estimate._asdict()
        results = {name: value for name, value in estimates.items() if value is not None}
        return in_precision_of(applied, (following, jnp.asarray(command.force), results))

    arithmetic = Arithmetic(single)
    values = [number] * len(parameters)
    leaves = [arithmetic.leaf("parameter", one.name, Kind.REAL) for one in parameters]
    state = jax.eval_shape(start, values, number)
    names, shapes = _state_names(state), jax.tree.leaves(state)
    kinds = [kind_of(shape.dtype) for shape in shapes]
    sizes = [size_of(shape.shape, f"the state {path}") for (_, path), shape in zip(names, shapes, strict=True)]
    held = [arithmetic.leaf("state", one, kind, size) for (one, _), kind, size in zip(names, kinds, sizes, strict=True)]
    position = arithmetic.leaf("input", Program.at_start.name, Kind.REAL)
    initial = evaluated(arithmetic, jax.make_jaxpr(start)(values, number), [*leaves, position])
    signals = [arithmetic.leaf("input", one.name, Kind.REAL) for one in inputs]
    jaxpr, out = jax.make_jaxpr(step, return_shape=True)(values, state, [number] * len(inputs))
    results = evaluated(arithmetic, jaxpr, [*leaves, *held, *signals])
    following, (force, *estimates) = results[: len(held)], results[len(held) :]
    estimated = [ESTIMATES[one] for one in sorted(out[2])]
    return _as_read(
        Program(
            name=name,
            kind=controller.kind or type(controller).__name__,
            period=period,
            single=single,
            parameters=parameters,
            inputs=inputs,
            outputs=((FORCE, force), *zip(estimated, estimates, strict=True)),
            states=tuple(
                State(one, path, said.unit, said.meaning, kind, size, first, after)
                for (one, path), said, kind, size, first, after in zip(
                    names, memories(state), kinds, sizes, initial, following, strict=True
                )
            ),
        )
    )


def _as_read(program: Program) -> Program:
    """Without parameters that change nothing, as `ki` beside a reset time; an input that changes nothing says so.

    The inputs stay: they are the same for every controller of an encoder.
    """
    read = {one.name for one in program.leaves}
    inputs = (
        one if one.name in read else one._replace(meaning=f"{one.meaning}; not read by this controller")
        for one in program.inputs
    )
    parameters = tuple(one for one in program.parameters if one.name in read)
    return replace(program, parameters=parameters, inputs=tuple(inputs))


def _parameters(controller: Controller) -> tuple[tuple[Parameter, ...], Callable[[Sequence[jax.Array]], Controller]]:
    """The declared numbers of a controller, and the function that puts others in their place."""
    found: list[tuple[str, str, str, float]] = []
    for path, declared, value in quantities(controller):
        if isinstance(value, Directional):
            for side, number in (("positive", value.positive), ("negative", value.negative)):
                meaning = f"{declared.meaning}, {side} direction"
                found.append((f"{path}.{side}", declared.unit, meaning, float(number)))
        elif value is not None:
            found.append((path, declared.unit, declared.meaning, float(value)))

    paths = [path for path, *_ in found]
    taken = [one.name for one in (*REFERENCE, *ENCODERS.values(), APPLIED, FORCE, *ESTIMATES.values())]
    sides = {".positive": "_pos", ".negative": "_neg"}
    names = identifiers(
        ends_of([re.sub(r"\.(positive|negative)$", lambda one: sides[one[0]], path) for path in paths]), taken
    )

    def with_values(values: Sequence[jax.Array]) -> Controller:
        return resolvable(with_nodes(controller, dict(zip(paths, values, strict=True))))

    return tuple(Parameter(name, *one) for name, one in zip(names, found, strict=True)), with_values


def _state_names(state: PyTree) -> list[tuple[str, str]]:
    """An identifier for each leaf of the state, and its path there."""
    paths = [jax.tree_util.keystr(path).lstrip(".") for path, _ in jax.tree_util.tree_flatten_with_path(state)[0]]
    return list(zip(identifiers(paths), paths, strict=True))
