"""The rigid table on its guides, integrated over one control period under a constant force.

One substep h solves the mean velocity w of the substep from the momentum balance

    2 M (w - v0) / h + B w = u - mean(F) ,   v1 = 2 w - v0 ,   x1 = x0 + h w

with the bristle solved for the frozen velocity w (`relaxation`): its mean deflection and its mean rate are linear in w,
so the balance is one scalar division. In stick (r -> 0) this is the implicit midpoint rule, in fast sliding (r h >> 1)
the bristle sits in its steady state; both limits, and everything between, are stable at any practical step. The
velocity at which a substep takes its friction is foretold by the balance of the substep before. Second order
(docs/method/numerics.md).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float

from diffdrive.model.friction import LoadedFriction, friction_under_load, nan_unless_positive
from diffdrive.model.parameters import Directional, Drive, Scalar
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import reciprocal
from diffdrive.numerics.relaxation import relaxation

UNROLLED = 5  # substeps in one piece: a lane by itself then takes a fifth less time (docs/evidence/performance.md)


class PlantState(NamedTuple):
    """Position (m), velocity (m/s) and bristle deflection (m) of the table."""

    position: Scalar
    velocity: Scalar
    bristle: Scalar


class _Table(NamedTuple):
    """The plant under one load, by the momentum p = 2 M / h: what the substeps of a period share."""

    friction: LoadedFriction
    stiffness: Directional  # s0 h / p
    damping: Directional  # s1 / p
    resistance: Directional  # 1 + (mu_v + B) / p
    momentum: Scalar  # p, N s/m
    give: Scalar  # 1 / p, m/s per newton
    step: float  # h, s


def _table(drive: Drive, load: Scalar, step: float) -> _Table:
    friction, damping, mass = friction_under_load(drive.friction, load), drive.plant.damping, drive.plant.mass
    give = 0.5 * step / mass

    def resisting(viscous: Scalar, damping: Scalar) -> Scalar:
        return 1.0 + (viscous + damping) * give

    # at once, or the compiler computes them anew in each substep
    return once(
        _Table(
            friction=friction,
            stiffness=jax.tree.map(lambda one: one * (step * give), friction.stiffness),
            damping=jax.tree.map(lambda one: one * give, friction.damping),
            resistance=jax.tree.map(resisting, friction.viscous, damping),
            momentum=2.0 * mass / step,
            give=give,
            step=step,
        )
    )


class _Balance(NamedTuple):
    """A substep whose friction is frozen: linear in the table's velocity and bristle and in what pushes it."""

    moving: Scalar  # weight of the velocity at the beginning, and of the push
    holding: Scalar  # 1/s, weight of the bristle's deflection
    per_resistance: Scalar  # one over the weight of the mean velocity
    stays: Scalar  # share of the bristle's deflection at the end
    drawn: Scalar  # s, of deflection at the end per mean velocity

    def mean_velocity(self, state: PlantState, push: Scalar) -> Scalar:
        """Over the substep, m/s."""
        return (self.moving * (state.velocity + push) - self.holding * state.bristle) * self.per_resistance


def _balance(table: _Table, slip: Scalar, deflection: Scalar) -> _Balance:
    """With the friction coefficients taken at velocity `slip`."""
    stiffness, damping = table.stiffness.towards(deflection), table.damping.towards(slip)
    # stages apart: what crosses is computed once, all else anew for each of its readers
    level, bent = once((nan_unless_positive(table.friction.level(slip)), stiffness * (table.momentum * jnp.abs(slip))))
    fade = relaxation(bent, level)
    yielding = stiffness * fade.mean_of_mean + damping * fade.mean
    resisting = table.resistance.towards(slip) * fade.common_denominator + yielding
    holding = (stiffness * fade.mean - damping * fade.gone) * (1.0 / table.step)
    holding, per_resistance = once((holding, reciprocal(resisting)))
    share = reciprocal(fade.common_denominator)
    return _Balance(fade.common_denominator, holding, per_resistance, fade.end * share, table.step * fade.mean * share)


class _Way(NamedTuple):
    """The table on its way through a period."""

    state: PlantState
    expected: Scalar  # m/s, mean velocity of the substep ahead, if the friction stayed as it was
    slip: Scalar  # m/s, at which it takes the friction


def _begin(table: _Table, state: PlantState, push: Scalar) -> _Way:
    expected = _balance(table, state.velocity, state.bristle).mean_velocity(state, push)
    return _Way(state, expected, expected)


def _substep(table: _Table, way: _Way, push: Scalar, push_ahead: Scalar) -> _Way:
    """`push_ahead` is that of the substep after this one."""
    state, expected, slip = way
    balance = _balance(table, slip, state.bristle)
    mean = once(balance.mean_velocity(state, push))
    ahead = PlantState(
        position=state.position + table.step * mean,
        velocity=2.0 * mean - state.velocity,
        bristle=balance.stays * state.bristle + balance.drawn * mean,
    )
    further = balance.mean_velocity(ahead, push_ahead)
    # friction will change the next mean velocity by about as much as it changed this one
    return once(_Way(ahead, further, further + (mean - expected)))


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
    table = _table(drive, load, period / substeps)
    push = table.give * (force + drive.plant.constant_force)
    course = _course(table, ripple)

    def body(way: _Way, rippling: Any) -> tuple[_Way, None]:
        return _substep(table, way, *_pushes(push, rippling)), None

    begin = _begin(table, state, _first(push, course))
    return lax.scan(body, begin, course, length=substeps, unroll=min(UNROLLED, substeps))[0].state


def _course(table: _Table, ripple: Float[Array, " substeps"] | None) -> Any:
    """How the push of each substep, and of the one after it, differs from that of the period."""
    if ripple is None:
        return None
    pushes = table.give * ripple
    return pushes, jnp.concatenate([pushes[1:], pushes[-1:]])


def _first(push: Scalar, course: Any) -> Scalar:
    return push if course is None else push + course[0][0]


def _pushes(push: Scalar, rippling: Any) -> tuple[Scalar, Scalar]:
    """What pushes in a substep and in the one after it."""
    return (push, push) if rippling is None else (push + rippling[0], push + rippling[1])


def advance_with_tangents(
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
    table = _table(drive, load, period / substeps)
    push = table.give * (force + drive.plant.constant_force)
    course, pushed = _course(table, ripple), [table.give * more for _, more in directions]

    def along(function: Any, at: Any, tangents: Any) -> tuple[Any, Any]:
        value, slope = jax.linearize(function, *at)
        return value, tuple(slope(*one) for one in tangents)

    def body(carry: Any, rippling: Any) -> tuple[Any, None]:
        way, tangents = carry
        ahead = [(tangent, more, more) for tangent, more in zip(tangents, pushed, strict=True)]
        return along(lambda *now: _substep(table, *now), (way, *_pushes(push, rippling)), ahead), None

    ways = [(state, more) for (state, _), more in zip(directions, pushed, strict=True)]
    begin = along(lambda *now: _begin(table, *now), (state, _first(push, course)), ways)
    (way, tangents), _ = lax.scan(body, begin, course, length=substeps)
    return way.state, [tangent.state for tangent in tangents]


def at_rest(position: Scalar) -> PlantState:
    """Standing still at `position`, bristle relaxed."""
    zero = jnp.zeros_like(jnp.asarray(position))
    return PlantState(jnp.asarray(position), zero, zero)
