"""The loop about a steady motion, by automatic differentiation of the control step itself.

The loop is opened where the amplifier's force reaches the table: what comes after it (table, friction, scale) and what
leads up to it (controller, observers, delay) are the very functions that `simulate` steps. Observers keep their own
account of the force that they asked for, as in the machine, so a gain in the loop is an amplifier or a mass that is not
as believed.

    force -> plant -> scale -> controller with its observers -> limit and delay -> force

A frequency response is differentiable in every gain. Its derivative follows from two solves at the point alone,
dL = dC r + l dB + l dA r with r = (z I - A)^-1 B and l = C (z I - A)^-1: many gains cost no more solves than one.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Complex, Float

from diffdrive.controllers import Controller, FrictionCompensation, Reference
from diffdrive.effects import stages
from diffdrive.effects.base import Push
from diffdrive.errors import ParameterError
from diffdrive.loop.simulate import LoopState, initial_state, step_machine
from diffdrive.model import actuator, plant, sensor
from diffdrive.model.friction import lugre_coefficients, steady_friction, stribeck_level
from diffdrive.model.parameters import Drive, Sampling, Scalar
from diffdrive.observers.load_estimator import FixedLoad
from diffdrive.support.resources import require_memory

SETTLING_TIME = 0.3  # s of the motion after which filters have found their gains
FROZEN = ("covariance", "count", "known", "started")  # no part of a small motion about the steady one
BALANCING = 8  # sweeps
MATRICES = 4  # of a loop that are in memory at once: itself, and what solving needs
MIN_COSINE = 1e-12  # cosine below which left and right eigenvectors tell no derivative: a multiple mode


class OperatingPoint(NamedTuple):
    """A steady motion: velocity (m/s; zero for a table at rest with a relaxed bristle) and applied load (N)."""

    velocity: Scalar
    load: Scalar


class OpenLoop(eqx.Module):
    """x' = A x + B force, asked = C x: from the force that acts on the table to the force asked for, per period."""

    a: Float[Array, "n n"]
    b: Float[Array, " n"]
    c: Float[Array, " n"]
    period: float = eqx.field(static=True)  # s

    @property
    def closed_loop(self) -> Float[Array, "n n"]:
        """The loop's own matrix, when the force asked for acts."""
        return self.a + jnp.outer(self.b, self.c)


def open_loop(drive: Drive, controller: Controller, sampling: Sampling, at: OperatingPoint) -> OpenLoop:
    """The loop about the steady motion `at`; give the smooth variants of drive and controller.

    Pure: for use under `jit`, `vmap`, and differentiation. The gains of a Kalman filter are those that it has settled
    to; that they too depend on its state is of second order where its innovation vanishes, and is left out.
    """
    drive = stages.with_machine_effects(drive, drive.effects)
    settled = _settled(drive, controller, sampling, at)
    held = (*FROZEN, "load") if _load_is_assumed(controller) else FROZEN
    moving, rebuild = _moving(settled, held)
    _require_room(moving.size, 1)
    reference = Reference(settled.plant.position, at.velocity, 0.0)

    def step(moving: Array, force: Scalar) -> tuple[Array, Scalar]:
        state = rebuild(moving)
        shown = state.plant.position + stages.scale_error(drive.effects, state.plant.position)
        measured = sensor.measure(drive.sensor, shown, None)
        inside, command = controller.step(
            state.controller, reference, measured, state.actuator.applied, sampling.period
        )
        asked = actuator.step(drive.actuator, state.actuator, command.force)
        carried, applied = stages.actuator_output(drive.effects, state.effects, asked.applied, sampling.period)
        table, carried, _ = step_machine(drive, sampling, state._replace(effects=carried), Push(force), 0.0, at.load)
        return _moving(LoopState(table, asked, inside, state.count, carried), held)[0], applied.mean

    force = _steady_force(drive, at)
    a, c = jax.jacfwd(step)(moving, force)
    b, _ = jax.jacfwd(step, argnums=1)(moving, force)
    return _balanced(a, b, c, sampling.period)


def _steady_force(drive: Drive, at: OperatingPoint) -> Scalar:
    sliding = steady_friction(drive.friction, at.velocity, at.load)
    return sliding + drive.plant.damping.towards(at.velocity) * at.velocity - drive.plant.constant_force


def _settled(drive: Drive, controller: Controller, sampling: Sampling, at: OperatingPoint) -> LoopState:
    """The loop after `SETTLING_TIME` of the steady motion, with what the controller made of watching it."""
    force, velocity = _steady_force(drive, at), at.velocity
    begin = initial_state(drive, controller, jnp.zeros(()))
    level = stribeck_level(drive.friction, velocity, at.load)
    deflection = jnp.sign(velocity) * level / lugre_coefficients(drive.friction, velocity, velocity, at.load).stiffness
    inside = begin.controller
    if isinstance(controller, FrictionCompensation):  # a filter that begins at the truth has only its gains to find
        before = -velocity * sampling.period  # its first step ends at the first position
        observed = inside.observer._replace(x=(before + 0.0 * force, velocity + 0.0 * force, deflection + 0.0 * force))
        if not _load_is_assumed(controller):
            observed = observed._replace(load=at.load + 0.0 * force)
        inside = inside._replace(observer=observed)

    def body(inside: Any, position: Scalar) -> tuple[Any, None]:
        reference = Reference(position, velocity, 0.0)
        return controller.step(inside, reference, position, force, sampling.period)[0], None

    count = max(2, round(SETTLING_TIME * sampling.rate))
    way = velocity * sampling.period * jnp.arange(count)
    inside, _ = lax.scan(body, inside, way)
    table = plant.PlantState(velocity * sampling.period * count, velocity + 0.0 * force, deflection + 0.0 * force)
    under_way = actuator.steady_state(drive.actuator, force)
    carried = _carried(drive, sampling, at, table, force, count)
    return LoopState(table, under_way, inside, begin.count, carried)


def _carried(
    drive: Drive, sampling: Sampling, at: OperatingPoint, table: plant.PlantState, force: Scalar, count: int
) -> tuple[Any, ...]:
    """The effects after as long a steady motion."""
    begin = stages.initial_states(drive.effects, force)
    if not drive.effects:
        return begin

    def body(carried: Any, k: Scalar) -> tuple[Any, None]:
        position = at.velocity * sampling.period * k
        seen = stages.seen_by(drive, sampling.period * k, position, table.velocity, table.bristle, force, 0.0, at.load)
        return stages.table_action(drive.effects, carried, seen, drive, sampling.period)[0], None

    return lax.scan(body, begin, jnp.arange(1.0, count + 1.0))[0]


def _load_is_assumed(controller: Controller) -> bool:
    estimator = getattr(getattr(controller, "observer", None), "load_estimator", None)
    return isinstance(estimator, FixedLoad)


def _moving(state: LoopState, held: tuple[str, ...]) -> tuple[Array, Any]:
    """What takes part in a small motion as one vector, and the way back to a whole state."""
    leaves, tree = jax.tree_util.tree_flatten_with_path(state)
    takes_part = [not any(getattr(key, "name", None) in held for key in path) for path, _ in leaves]
    vector, unravel = ravel_pytree([leaf for (_, leaf), moves in zip(leaves, takes_part, strict=True) if moves])

    def rebuild(vector: Array) -> Any:
        moved = iter(unravel(vector))
        pairs = zip(leaves, takes_part, strict=True)
        return tree.unflatten(next(moved) if moves else leaf for (_, leaf), moves in pairs)

    return vector, rebuild


def _balanced(a: Array, b: Array, c: Array, period: float) -> OpenLoop:
    """The same loop in coordinates of like size (metres of bristle beside newtons of load), by Osborne's sweeps."""
    size = len(b)
    whole = lax.stop_gradient(jnp.abs(a) + jnp.abs(jnp.outer(b, c))) * (1.0 - jnp.eye(size))
    scale = jnp.ones(size)
    for _ in range(BALANCING):
        here = whole * scale[None, :] / scale[:, None]
        into, out = jnp.linalg.norm(here, axis=1), jnp.linalg.norm(here, axis=0)
        both = (into > 0) & (out > 0)
        scale = scale * jnp.where(both, jnp.sqrt(jnp.where(both, into, 1.0) / jnp.where(both, out, 1.0)), 1.0)
    return OpenLoop(a * scale[None, :] / scale[:, None], b / scale, c * scale, period)


def _require_room(size: int, count: int) -> None:
    """Raise `ParameterError` where the matrices of a loop with so many states, `count` of them, are too large."""
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
    _require_room(len(b), count)
    right = jnp.linalg.solve(matrix, jnp.broadcast_to(b + 0j, (count, len(b)))[..., None])[..., 0]
    left = jnp.linalg.solve(jnp.swapaxes(matrix, 1, 2), jnp.broadcast_to(c + 0j, (count, len(c)))[..., None])[..., 0]
    # d/dz (z I - A)^-1 = -(z I - A)^-2, and dz = j z d(angle)
    slope = jnp.sum(left * right, axis=1) * (1j * z * angle)
    value = right @ c
    bent = right @ (loop.c - c) + left @ (loop.b - b) + jnp.einsum("fi,ij,fj->f", left, loop.a - a, right)
    return Response(jnp.asarray(frequency), -(value + bent), slope)


def growth_rate(loop: OpenLoop) -> Scalar:
    """Growth rate (1/s) of the closed loop's slowest decaying motion: below zero where the loop is stable.

    Differentiable once, where one mode or one oscillation leads: d(eigenvalue) = l dA r / (l r), by its eigenvectors.
    """
    matrix = loop.closed_loop
    fixed = lax.stop_gradient(matrix)
    values, left, right = lax.linalg.eig(fixed)
    leads = jnp.argmax(jnp.abs(values))
    value, left, right = values[leads], jnp.conj(left[:, leads]), right[:, leads]
    along = left @ right
    share = jnp.where(jnp.abs(along) > MIN_COSINE, 1.0, 0.0) / jnp.where(
        jnp.abs(along) > MIN_COSINE, along * value, 1.0
    )
    moved = jnp.real(share * (left @ (matrix - fixed) @ right))
    return (jnp.log(jnp.abs(value)) + moved) / loop.period
