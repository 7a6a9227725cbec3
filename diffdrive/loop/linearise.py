"""The loop about a steady motion, by automatic differentiation of the control step itself.

The loop is opened where the amplifier's force reaches the table: the parts after it (table, friction, encoders) and
before it (controller, observers, delay) are the very functions that `simulate` steps. Observers use the force that they
requested, as in the machine, so a gain in the loop is an amplifier or a mass that differs from the model.

    force -> plant -> encoders -> controller with its observers -> limit and delay -> force

A frequency response is differentiable in every gain. Its derivative follows from two solves at the point alone,
dL = dC r + l dB + l dA r with r = (z I - A)^-1 B and l = C (z I - A)^-1: many gains cost no more solves than one.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jax.scipy.linalg import lu_factor, lu_solve
from jaxtyping import Array, Complex, Float, PyTree

from diffdrive.controllers import Controller, Encoders, Reference
from diffdrive.effects import stages
from diffdrive.effects.base import Push
from diffdrive.errors import ParameterError
from diffdrive.loop.encoders import read_encoders
from diffdrive.loop.step import LoopState, initial_state, step_machine
from diffdrive.model import actuator, plant
from diffdrive.model.friction import lugre_coefficients, resolvable, steady_friction, stribeck_level
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.resources import require_memory

SETTLING_TIME = 0.3  # s of the motion after which filters have converged to their gains
BALANCING = 8  # sweeps
MATRICES = 4  # of a loop that are in memory at once: itself, and the solver's
MIN_COSINE = 1e-12  # between left and right eigenvector; below it the mode is multiple and has no derivative


class OperatingPoint(NamedTuple):
    """A steady motion: velocity (m/s; zero for a table at rest with a relaxed bristle) and applied load (N)."""

    velocity: Scalar
    load: Scalar


class OpenLoop(eqx.Module):
    """x' = A x + B force, requested = C x: from the force on the table to the force requested, per period."""

    a: Float[Array, "n n"]
    b: Float[Array, " n"]
    c: Float[Array, " n"]
    period: float = eqx.field(static=True)  # s

    @property
    def closed_loop(self) -> Float[Array, "n n"]:
        """The matrix of the closed loop, in which the requested force acts."""
        return self.a + jnp.outer(self.b, self.c)


class StepInputs(NamedTuple):
    """What enters a control step from outside: the force on the table (N), the reference, and what is added to the
    controller's command (N; None: nothing is).
    """

    force: Scalar
    reference: Reference
    command: Scalar | None = None


class StepOutputs(NamedTuple):
    """What leaves a control step: the command and the force requested by it (N), and the readings before it."""

    command: Scalar
    requested: Scalar
    encoders: Encoders


class SteadyStep(NamedTuple):
    """A control step about a steady motion: its state as a vector, its inputs there, and the step itself."""

    vector: Float[Array, " n"]
    inputs: StepInputs
    step: Callable[[Array, StepInputs], tuple[Array, StepOutputs]]


def open_loop(drive: Drive, controller: Controller, sampling: Sampling, point: OperatingPoint) -> OpenLoop:
    """The loop about the steady motion `point`, of the smooth variants of drive and controller.

    Pure: for use under `jit`, `vmap`, and differentiation. The gains of a Kalman filter are its steady ones; their
    dependence on its state is of second order where its innovation vanishes, and is left out.
    """
    vector, inputs, step = steady_step(drive, controller, sampling, point, lambda state: _is_dynamic(state, controller))

    def requested(vector: Array, force: Scalar) -> tuple[Array, Scalar]:
        ahead, outputs = step(vector, inputs._replace(force=force))
        return ahead, outputs.requested

    (a, b), (c, _) = jax.jacfwd(requested, argnums=(0, 1))(vector, inputs.force)  # in one pass
    return balanced(a, b, c, sampling.period)


def steady_step(
    drive: Drive,
    controller: Controller,
    sampling: Sampling,
    point: OperatingPoint,
    is_dynamic: Callable[[LoopState], PyTree],
) -> SteadyStep:
    """The control step about `point`, in which the states move that `is_dynamic` says (true or false for each)."""
    drive, controller = resolvable((stages.with_machine_effects(drive, drive.effects), controller))
    settled = _settled_state(drive, controller, sampling, point)
    vector, rebuild = _state_vector(settled, is_dynamic)
    _require_memory(vector.size, 1)
    reference = _steady_reference(controller, sampling, settled.plant.position, point.velocity)
    motor_zero = _motor_ahead(drive, settled)

    def step(vector: Array, inputs: StepInputs) -> tuple[Array, StepOutputs]:
        state = rebuild(vector)
        encoders = _zeroed(read_encoders(drive, state.plant.position, state.effects), motor_zero)
        controller_state, command = controller.step_from_encoders(
            state.controller, inputs.reference, encoders, state.actuator.applied, sampling.period
        )
        commanded = command.force if inputs.command is None else command.force + inputs.command
        requested = actuator.step(drive.actuator, state.actuator, commanded, sampling.period)
        effect_states, applied = stages.actuator_output(
            drive.effects, state.effects, requested.applied, sampling.period
        )
        table, effect_states, _ = step_machine(
            drive, sampling, state._replace(effects=effect_states), Push(inputs.force), 0.0, point.load
        )
        ahead = LoopState(table, requested, controller_state, state.count, effect_states)
        return _state_vector(ahead, is_dynamic)[0], StepOutputs(commanded, applied.mean, encoders)

    return SteadyStep(vector, StepInputs(_steady_force(drive, point), reference), step)


def _motor_ahead(drive: Drive, settled: LoopState) -> Scalar | None:
    """What the motor encoder reads beyond the table's position (m) in the steady motion; None without one."""
    if drive.motor_encoder is None:
        return None
    return read_encoders(drive, settled.plant.position, settled.effects).at("motor") - settled.plant.position


def _zeroed(encoders: Encoders, motor_zero: Scalar | None) -> Encoders:
    """The readings with both encoders at one zero in the steady motion, in which the controller has settled.

    The zero of an encoder has no part in a small motion; a step between them would run the controller into its limits.
    """
    if encoders.motor is None or motor_zero is None:
        return encoders
    return encoders._replace(motor=encoders.motor - motor_zero)


def _steady_force(drive: Drive, point: OperatingPoint) -> Scalar:
    sliding = steady_friction(drive.friction, point.velocity, point.load)
    return sliding + drive.plant.damping.towards(point.velocity) * point.velocity - drive.plant.constant_force


def _settled_state(drive: Drive, controller: Controller, sampling: Sampling, point: OperatingPoint) -> LoopState:
    """The loop after `SETTLING_TIME` of the steady motion."""
    force, velocity = _steady_force(drive, point), point.velocity
    initial = initial_state(drive, controller, jnp.zeros(()))
    level = stribeck_level(drive.friction, velocity, point.load)
    stiffness = lugre_coefficients(drive.friction, velocity, velocity, point.load).stiffness
    deflection = jnp.sign(velocity) * level / stiffness
    # a filter that begins at the true state only has to find its gains; its first step ends at the first position
    known = (-velocity * sampling.period, velocity, deflection, point.load)
    controller_state = controller.moving(initial.controller, *(number + 0.0 * force for number in known))

    def body(controller_state: PyTree, position: Scalar) -> tuple[PyTree, None]:
        reference = _steady_reference(controller, sampling, position, velocity)
        return controller.step(controller_state, reference, position, force, sampling.period)[0], None

    count = max(2, round(SETTLING_TIME * sampling.rate))
    positions = velocity * sampling.period * jnp.arange(count)
    controller_state, _ = lax.scan(body, controller_state, positions)
    table = plant.PlantState(velocity * sampling.period * count, velocity + 0.0 * force, deflection + 0.0 * force)
    actuator_state = actuator.steady_state(drive.actuator, force)
    effect_states = _settled_effects(drive, sampling, point, table, force, count)
    return LoopState(table, actuator_state, controller_state, initial.count, effect_states)


def _steady_reference(controller: Controller, sampling: Sampling, position: Scalar, velocity: Scalar) -> Reference:
    """The reference that the table follows at a steady velocity; by any other an integral would run into its limit."""
    error = controller.following_error(velocity, sampling.period)
    return Reference(position if error is None else position + error, velocity, 0.0)


def _settled_effects(
    drive: Drive,
    sampling: Sampling,
    point: OperatingPoint,
    table: plant.PlantState,
    force: Scalar,
    count: int,
) -> tuple[PyTree, ...]:
    """The states of the effects after the same steady motion."""
    initial = stages.initial_states(drive.effects, force)
    if not drive.effects:
        return initial

    def body(effect_states: PyTree, k: Scalar) -> tuple[PyTree, None]:
        position = point.velocity * sampling.period * k
        seen = stages.seen_by(
            drive, sampling.period * k, position, table.velocity, table.bristle, force, 0.0, point.load
        )
        return stages.table_action(drive.effects, effect_states, seen, drive, sampling.period)[0], None

    return lax.scan(body, initial, jnp.arange(1.0, count + 1.0))[0]


def _state_vector(
    state: LoopState, is_dynamic: Callable[[LoopState], PyTree]
) -> tuple[Array, Callable[[Array], LoopState]]:
    """The states that take part in a small motion as one vector, and the function from it to a complete state."""
    leaves, tree = jax.tree.flatten(state)
    dynamic_leaves = jax.tree.leaves(is_dynamic(state))
    vector, unravel = ravel_pytree([leaf for leaf, dynamic in zip(leaves, dynamic_leaves, strict=True) if dynamic])

    def rebuild(vector: Array) -> LoopState:
        values = iter(unravel(vector))
        pairs = zip(leaves, dynamic_leaves, strict=True)
        return jax.tree.unflatten(tree, (next(values) if dynamic else leaf for leaf, dynamic in pairs))

    return vector, rebuild


def _is_dynamic(state: LoopState, controller: Controller) -> PyTree:
    """For each state whether it takes part in a small motion about the steady one: the controller knows of its own."""

    def of_part(flag: bool, part: PyTree) -> PyTree:
        return jax.tree.map(lambda leaf: flag and jnp.issubdtype(jnp.result_type(leaf), jnp.floating), part)

    declared = jax.tree.map(lambda _: True, state)._replace(controller=controller.is_dynamic(state.controller))
    return jax.tree.map(of_part, declared, state)


def balanced(a: Array, b: Array, c: Array, period: float) -> OpenLoop:
    """The same loop in balanced coordinates (metres of bristle beside newtons of load), by Osborne's sweeps."""
    size = len(b)
    magnitude = lax.stop_gradient(jnp.abs(a) + jnp.abs(jnp.outer(b, c))) * (1.0 - jnp.eye(size))
    scale = jnp.ones(size)
    for _ in range(BALANCING):
        scaled = magnitude * scale[None, :] / scale[:, None]
        row_norms, column_norms = jnp.linalg.norm(scaled, axis=1), jnp.linalg.norm(scaled, axis=0)
        is_coupled = (row_norms > 0) & (column_norms > 0)
        scale = scale * jnp.where(
            is_coupled, jnp.sqrt(jnp.where(is_coupled, row_norms, 1.0) / jnp.where(is_coupled, column_norms, 1.0)), 1.0
        )
    return OpenLoop(a * scale[None, :] / scale[:, None], b / scale, c * scale, period)


def _require_memory(size: int, count: int) -> None:
    """Raise `ParameterError` where `count` matrices of a loop with `size` states do not fit into memory."""
    require_memory(
        ParameterError,
        f"a linearised loop of {size} states",
        16.0 * MATRICES * count * size**2,
        "shorten actuator.delay_samples or controller.velocity_samples, of which each sample is a state",
    )


class Response(NamedTuple):
    """A loop's frequency response L, with 1 + L the return difference, and dL/d(log frequency)."""

    frequency: Float[Array, " f"]  # Hz
    loop: Complex[Array, " f"]
    slope: Complex[Array, " f"]


def response(loop: OpenLoop, frequency: Float[Array, " f"] | Float[np.ndarray, " f"]) -> Response:
    """The frequency response of an open loop, negative feedback understood; differentiable once, in the loop."""
    angle = 2.0 * np.pi * jnp.asarray(frequency) * loop.period
    z = jnp.exp(1j * angle)
    a, b, c = lax.stop_gradient((loop.a, loop.b, loop.c))
    matrix = z[:, None, None] * np.eye(len(b)) - a
    count = len(frequency)
    _require_memory(len(b), count)
    # one decomposition serves both
    factors = lu_factor(matrix)
    right, left = (
        lu_solve(factors, jnp.broadcast_to(vector + 0j, (count, len(b)))[..., None], trans=transposed)[..., 0]
        for transposed, vector in enumerate((b, c))
    )
    # d/dz (z I - A)^-1 = -(z I - A)^-2, and dz = j z d(angle)
    slope = jnp.sum(left * right, axis=1) * (1j * z * angle)
    value = right @ c
    first_order = right @ (loop.c - c) + left @ (loop.b - b) + jnp.einsum("fi,ij,fj->f", left, loop.a - a, right)
    return Response(jnp.asarray(frequency), -(value + first_order), slope)


def growth_rate(loop: OpenLoop) -> Scalar:
    """Growth rate (1/s) of the closed loop's dominant mode: below zero where the loop is stable.

    Differentiable once, where one mode or one oscillation dominates: d(eigenvalue) = l dA r / (l r).
    """
    matrix = loop.closed_loop
    fixed_matrix = lax.stop_gradient(matrix)
    values, left, right = lax.linalg.eig(fixed_matrix)
    dominant = jnp.argmax(jnp.abs(values))
    value, left, right = values[dominant], jnp.conj(left[:, dominant]), right[:, dominant]
    cosine = left @ right
    share = jnp.where(jnp.abs(cosine) > MIN_COSINE, 1.0, 0.0) / jnp.where(
        jnp.abs(cosine) > MIN_COSINE, cosine * value, 1.0
    )
    first_order = jnp.real(share * (left @ (matrix - fixed_matrix) @ right))
    return (jnp.log(jnp.abs(value)) + first_order) / loop.period
