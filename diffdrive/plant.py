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

from diffdrive.friction import Decay, Loaded, decay_of, under
from diffdrive.parameters import Directional, Drive, Scalar


class PlantState(NamedTuple):
    """Position (m), velocity (m/s) and bristle deflection (m) of the table."""

    position: Scalar
    velocity: Scalar
    bristle: Scalar


class _Table(NamedTuple):
    """The plant under one load: what the substeps of a period share."""

    friction: Loaded
    resistance: Directional  # viscous friction and damping, N s/m
    momentum: Scalar  # 2 M / h, N s/m
    step: float  # h, s


def _table(drive: Drive, load: Scalar, step: float) -> _Table:
    friction, damping = under(drive.friction, load), drive.plant.damping
    viscous = friction.viscous
    resistance = Directional(viscous.positive + damping.positive, viscous.negative + damping.negative)
    return _Table(friction, resistance, 2.0 * drive.plant.mass / step, step)


def _mean_velocity(table: _Table, state: PlantState, slip: Scalar, force: Scalar) -> tuple[Scalar, Decay]:
    """Mean velocity over a substep with the friction coefficients taken at velocity `slip`, under all outer forces."""
    _, velocity, deflection = state
    bristle, step = table.friction.at(slip, deflection), table.step
    fade = lax.optimization_barrier(decay_of(bristle.stiffness * jnp.abs(slip) * step, bristle.level))
    yielding = bristle.stiffness * step * fade.mean_of_mean + bristle.damping * fade.mean
    held = deflection * fade.mean * (bristle.stiffness - bristle.damping * (fade.x * (1.0 / step)))
    resistance = table.resistance.towards(slip)
    mean = _quotient(table.momentum * velocity + force - held, table.momentum + resistance + yielding)
    return mean, fade


@jax.custom_jvp
def _quotient(top: Scalar, bottom: Scalar) -> Scalar:
    return top / bottom


@_quotient.defjvp
def _quotient_slope(primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    """By one further division, however many tangents there are."""
    mean, inverse = lax.optimization_barrier((_quotient(*primals), 1.0 / primals[1]))
    return mean, lax.optimization_barrier((tangents[0] - mean * tangents[1]) * inverse)


def _first_slip(table: _Table, state: PlantState, force: Scalar) -> Scalar:
    """The velocity at which the first substep takes the friction."""
    return _mean_velocity(table, state, state.velocity, force)[0]


def _substep(table: _Table, state: PlantState, slip: Scalar, force: Scalar) -> tuple[PlantState, Scalar]:
    """The state, and the velocity at which the next substep takes the friction."""
    (mean, fade), step = _mean_velocity(table, state, slip, force), table.step
    ahead = PlantState(
        position=state.position + step * mean,
        velocity=2.0 * mean - state.velocity,
        bristle=fade.end * state.bristle + step * fade.mean * mean,
    )
    # the next midpoint velocity is extrapolated: second order without a second pass
    return lax.optimization_barrier((ahead, 3.0 * mean - 2.0 * state.velocity))


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
    table, force = _table(drive, load, period / substeps), force + drive.plant.constant_force

    def body(carry: tuple[PlantState, Scalar], pushed: Any) -> tuple[tuple[PlantState, Scalar], None]:
        state, slip = carry
        return _substep(table, state, *_rippled(table, slip, force, pushed)), None

    begin = (state, _first_slip(table, state, force))
    return lax.scan(body, begin, _course(ripple), length=substeps)[0][0]


def _course(ripple: Float[Array, " substeps"] | None) -> Any:
    """The ripple of each substep, and by how much it differs from that of the one before."""
    return None if ripple is None else (ripple, jnp.diff(ripple, prepend=0.0))


def _rippled(table: _Table, slip: Scalar, force: Scalar, pushed: Any) -> tuple[Scalar, Scalar]:
    """Slip and force of a substep: the slip was extrapolated under the force of the substep before."""
    if pushed is None:
        return slip, force
    ripple, jump = pushed
    return slip + jump / table.momentum, force + ripple


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
    table, force = _table(drive, load, period / substeps), force + drive.plant.constant_force

    def along(function: Any, at: Any, tangents: Any) -> tuple[Any, Any]:
        value, slope = jax.linearize(function, *at)
        return value, tuple(slope(*one) for one in tangents)

    def body(carry: Any, pushed: Any) -> tuple[Any, None]:
        (state, slip), tangents = carry
        at = (state, *_rippled(table, slip, force, pushed))
        ahead = [(*tangent, push) for tangent, (_, push) in zip(tangents, directions, strict=True)]
        return along(lambda *now: _substep(table, *now), at, ahead), None

    slip, slips = along(lambda *now: _first_slip(table, *now), (state, force), directions)
    tangents = tuple((tangent, one) for (tangent, _), one in zip(directions, slips, strict=True))
    ((state, _), tangents), _ = lax.scan(body, ((state, slip), tangents), _course(ripple), length=substeps)
    return state, [tangent for tangent, _ in tangents]


def at_rest(position: Scalar) -> PlantState:
    """Standing still at `position`, bristle relaxed."""
    zero = jnp.zeros_like(jnp.asarray(position))
    return PlantState(jnp.asarray(position), zero, zero)
