"""The rigid table on its guides, integrated over one control period under a constant force.

One substep h solves the mean velocity w of the substep from the momentum balance

    2 M (w - v0) / h + B w = u - mean(F) ,   v1 = 2 w - v0 ,   x1 = x0 + h w

with the bristle solved exactly for the frozen velocity w: its mean deflection and its mean rate are linear in w, so the
balance is one scalar division. In stick (r -> 0) this is the implicit midpoint rule, in fast sliding (r h >> 1) the
bristle sits in its steady state; both limits, and everything between, are stable at any practical step. Second order
(docs/numerics.md).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.friction import Decay, bristle_at, decay
from diffdrive.parameters import Drive, Scalar


class PlantState(NamedTuple):
    """Position (m), velocity (m/s) and bristle deflection (m) of the table."""

    position: Scalar
    velocity: Scalar
    bristle: Scalar


def _mean_velocity(
    drive: Drive, state: PlantState, slip: Scalar, force: Scalar, load: Scalar, step: float
) -> tuple[Scalar, Decay]:
    """Mean velocity over `step` with the friction coefficients taken at velocity `slip`."""
    _, velocity, deflection = state
    bristle = bristle_at(drive.friction, slip, deflection, load)
    fade = decay(bristle.rate * step)
    momentum = 2.0 * drive.plant.mass / step
    resistance = bristle.viscous + drive.plant.damping.towards(slip)
    yielding = bristle.stiffness * step * fade.mean_of_mean + bristle.damping * fade.mean
    held = deflection * fade.mean * (bristle.stiffness - bristle.damping * bristle.rate)
    mean = (momentum * velocity + force + drive.plant.constant_force - held) / (momentum + resistance + yielding)
    return mean, fade


def _first_slip(drive: Drive, state: PlantState, force: Scalar, load: Scalar, step: float) -> Scalar:
    """The velocity at which the first substep takes the friction."""
    return _mean_velocity(drive, state, state.velocity, force, load, step)[0]


def _substep(
    drive: Drive, state: PlantState, slip: Scalar, force: Scalar, load: Scalar, step: float
) -> tuple[PlantState, Scalar]:
    """The state, and the velocity at which the next substep takes the friction."""
    mean, fade = _mean_velocity(drive, state, slip, force, load, step)
    ahead = PlantState(
        position=state.position + step * mean,
        velocity=2.0 * mean - state.velocity,
        bristle=fade.end * state.bristle + step * fade.mean * mean,
    )
    # the next midpoint velocity is extrapolated: second order without a second pass
    return lax.optimization_barrier((ahead, 2.0 * ahead.velocity - mean))


def advance(
    drive: Drive,
    state: PlantState,
    force: Scalar,
    load: Scalar,
    period: float,
    substeps: int,
    ripple: Float[Array, " substeps"] | None = None,
) -> PlantState:
    """The state one `period` (s) later under a constant `force` (N) and applied `load` (N).

    `ripple` (N) is by how much the force of each substep differs from `force`.
    """
    step = period / substeps

    def body(carry: tuple[PlantState, Scalar], pushed: Any) -> tuple[tuple[PlantState, Scalar], None]:
        state, slip = carry
        return _substep(drive, state, *_rippled(drive, slip, force, pushed, step), load, step), None

    begin = (state, _first_slip(drive, state, force, load, step))
    return lax.scan(body, begin, _course(ripple), length=substeps)[0][0]


def _course(ripple: Float[Array, " substeps"] | None) -> Any:
    """The ripple of each substep, and by how much it differs from that of the one before."""
    return None if ripple is None else (ripple, jnp.diff(ripple, prepend=0.0))


def _rippled(drive: Drive, slip: Scalar, force: Scalar, pushed: Any, step: float) -> tuple[Scalar, Scalar]:
    """Slip and force of a substep: the slip was extrapolated under the force of the substep before."""
    if pushed is None:
        return slip, force
    ripple, jump = pushed
    return slip + jump * step / (2.0 * drive.plant.mass), force + ripple


def advance_along(
    drive: Drive,
    state: PlantState,
    force: Scalar,
    load: Scalar,
    period: float,
    substeps: int,
    directions: Sequence[tuple[PlantState, Scalar]],
    ripple: Float[Array, " substeps"] | None = None,
) -> tuple[PlantState, list[PlantState]]:
    """`advance`, and its derivatives along each of some directions of state and force.

    All tangents are carried through one loop; the derivative of the loop would run it anew for each direction.
    """
    step = period / substeps

    def along(function: Any, at: Any, tangents: Any) -> tuple[Any, Any]:
        value, slope = jax.linearize(function, *at)
        return value, tuple(slope(*one) for one in tangents)

    def body(carry: Any, pushed: Any) -> tuple[Any, None]:
        (state, slip), tangents = carry
        at = (state, *_rippled(drive, slip, force, pushed, step))
        ahead = [(*tangent, push) for tangent, (_, push) in zip(tangents, directions, strict=True)]
        return along(lambda *now: _substep(drive, *now, load, step), at, ahead), None

    slip, slips = along(lambda *now: _first_slip(drive, *now, load, step), (state, force), directions)
    tangents = tuple((tangent, one) for (tangent, _), one in zip(directions, slips, strict=True))
    ((state, _), tangents), _ = lax.scan(body, ((state, slip), tangents), _course(ripple), length=substeps)
    return state, [tangent for tangent, _ in tangents]


def at_rest(position: Scalar) -> PlantState:
    """Standing still at `position`, bristle relaxed."""
    zero = jnp.zeros_like(jnp.asarray(position))
    return PlantState(jnp.asarray(position), zero, zero)
