"""The rigid table on its guides, integrated over one control period under a constant force.

One substep h solves the mean velocity w of the substep from the momentum balance

    2 M (w - v0) / h + B w = u - mean(F) ,   v1 = 2 w - v0 ,   x1 = x0 + h w

with the bristle solved for the frozen velocity w (`relaxation`): its mean deflection and its mean rate are linear in w,
so the balance is one scalar division. In stick (r -> 0) this is the implicit midpoint rule, in fast sliding (r h >> 1)
the bristle sits in its steady state; both limits, and everything between, are stable at any practical step. The
velocity at which a substep evaluates its friction is predicted by the balance of the substep before. Second order
(docs/method/numerics.md).
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.model.friction import LoadedFriction, friction_under_load, nan_unless_positive
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import reciprocal
from diffdrive.numerics.relaxation import relaxation

UNROLLED = 5  # substeps: a single lane then takes a fifth less time (docs/evidence/performance.md)


class PlantState(NamedTuple):
    """Position (m), velocity (m/s) and bristle deflection (m) of the table."""

    position: Scalar
    velocity: Scalar
    bristle: Scalar


class _PlantUnderLoad(NamedTuple):
    """The plant under one load, over the momentum p = 2 M / h: what all substeps of a period share."""

    friction: LoadedFriction
    stiffness: Directional  # s0 h / p
    damping: Directional  # s1 / p
    resistance: Directional  # 1 + (mu_v + B) / p
    momentum: Scalar  # p, N s/m
    mobility: Scalar  # 1 / p, m/s per newton
    step: Scalar  # h, s


def _plant_under_load(drive: Drive, load: Scalar, step: Scalar) -> _PlantUnderLoad:
    friction, damping, mass = friction_under_load(drive.friction, load), drive.plant.damping, drive.plant.mass
    mobility = 0.5 * step / mass

    def total_resistance(viscous: Scalar, damping: Scalar) -> Scalar:
        return 1.0 + (viscous + damping) * mobility

    # behind a barrier, or the compiler computes them again in each substep
    return once(
        _PlantUnderLoad(
            friction=friction,
            stiffness=jax.tree.map(lambda value: value * (step * mobility), friction.stiffness),
            damping=jax.tree.map(lambda value: value * mobility, friction.damping),
            resistance=jax.tree.map(total_resistance, friction.viscous, damping),
            momentum=2.0 * mass / step,
            mobility=mobility,
            step=step,
        )
    )


class _Balance(NamedTuple):
    """A substep with frozen friction coefficients: linear in velocity, bristle and push (force over p, m/s)."""

    inertia_weight: Scalar  # weight of the velocity at the beginning, and of the push
    bristle_weight: Scalar  # 1/s, weight of the bristle's deflection
    per_resistance: Scalar  # one over the weight of the mean velocity
    deflection_share: Scalar  # share of the bristle's deflection at the end
    deflection_per_velocity: Scalar  # s, of deflection at the end per mean velocity

    def mean_velocity(self, state: PlantState, push: Scalar) -> Scalar:
        """Over the substep, m/s."""
        return (
            self.inertia_weight * (state.velocity + push) - self.bristle_weight * state.bristle
        ) * self.per_resistance


def _balance(plant: _PlantUnderLoad, friction_velocity: Scalar, deflection: Scalar) -> _Balance:
    """With the friction coefficients taken at velocity `slip`."""
    stiffness, damping = plant.stiffness.towards(deflection), plant.damping.towards(friction_velocity)
    # barriers between the stages: without them the compiler computes a value again for each of its readers
    level, scaled_stiffness = once(
        (
            nan_unless_positive(plant.friction.level(friction_velocity)),
            stiffness * (plant.momentum * jnp.abs(friction_velocity)),
        )
    )
    shares = relaxation(scaled_stiffness, level)
    bristle_resistance = stiffness * shares.mean_of_mean + damping * shares.mean
    denominator = plant.resistance.towards(friction_velocity) * shares.common_denominator + bristle_resistance
    bristle_weight = (stiffness * shares.mean - damping * shares.released) * (1.0 / plant.step)
    bristle_weight, per_resistance = once((bristle_weight, reciprocal(denominator)))
    per_denominator = reciprocal(shares.common_denominator)
    return _Balance(
        shares.common_denominator,
        bristle_weight,
        per_resistance,
        shares.remaining * per_denominator,
        plant.step * shares.mean * per_denominator,
    )


class _SubstepState(NamedTuple):
    """The table between two substeps."""

    state: PlantState
    predicted_velocity: Scalar  # m/s, mean velocity of the substep ahead, if the friction stayed as it was
    friction_velocity: Scalar  # m/s, at which the friction is evaluated


def _begin(plant: _PlantUnderLoad, state: PlantState, push: Scalar) -> _SubstepState:
    return _begin_under(_balance(plant, state.velocity, state.bristle), state, push)


def _begin_under(balance: _Balance, state: PlantState, push: Scalar) -> _SubstepState:
    """Linear in the state and the push."""
    predicted = balance.mean_velocity(state, push)
    return _SubstepState(state, predicted, predicted)


def _substep(plant: _PlantUnderLoad, current: _SubstepState, push: Scalar, push_ahead: Scalar) -> _SubstepState:
    """One substep; `push_ahead` is the push of the next one."""
    balance = _balance(plant, current.friction_velocity, current.state.bristle)
    return _substep_under(balance, plant.step, current, push, push_ahead)


def _substep_under(
    balance: _Balance, step: Scalar, current: _SubstepState, push: Scalar, push_ahead: Scalar
) -> _SubstepState:
    """Linear in the state and the pushes: a substep is nonlinear in the velocity of its friction alone."""
    state, predicted, _ = current
    mean = once(balance.mean_velocity(state, push))
    ahead = PlantState(
        position=state.position + step * mean,
        velocity=2.0 * mean - state.velocity,
        bristle=balance.deflection_share * state.bristle + balance.deflection_per_velocity * mean,
    )
    predicted_ahead = balance.mean_velocity(ahead, push_ahead)
    # friction will change the next mean velocity by about as much as it changed this one
    return once(_SubstepState(ahead, predicted_ahead, predicted_ahead + (mean - predicted)))


def advance(
    drive: Drive,
    state: PlantState,
    force: Scalar,
    load: Scalar,
    period: Scalar,
    substeps: int,
    ripple: Float[Array, " substeps"] | None = None,
) -> PlantState:
    """The state one `period` (s) later under a constant `force` (N) and applied `load` (N).

    `ripple` (N) is the difference of each substep's force from `force`.
    """
    plant = _plant_under_load(drive, load, period / substeps)
    push = plant.mobility * (force + drive.plant.constant_force)
    ripple_pushes = _ripple_pushes(plant, ripple)

    def body(current: _SubstepState, ripple_push: tuple[Scalar, Scalar] | None) -> tuple[_SubstepState, None]:
        return _substep(plant, current, *_pushes(push, ripple_push)), None

    begin = _begin(plant, state, _first_push(push, ripple_pushes))
    return lax.scan(body, begin, ripple_pushes, length=substeps, unroll=min(UNROLLED, substeps))[0].state


def _ripple_pushes(plant: _PlantUnderLoad, ripple: Float[Array, " substeps"] | None) -> tuple[Array, Array] | None:
    """How the push of each substep, and of the next one, differs from that of the period."""
    if ripple is None:
        return None
    pushes = plant.mobility * ripple
    return pushes, jnp.concatenate([pushes[1:], pushes[-1:]])


def _first_push(push: Scalar, ripple_pushes: tuple[Array, Array] | None) -> Scalar:
    return push if ripple_pushes is None else push + ripple_pushes[0][0]


def _pushes(push: Scalar, ripple_push: tuple[Scalar, Scalar] | None) -> tuple[Scalar, Scalar]:
    """The push in a substep and in the next one."""
    return (push, push) if ripple_push is None else (push + ripple_push[0], push + ripple_push[1])


def advance_with_tangents(
    drive: Drive,
    state: PlantState,
    force: Scalar,
    load: Scalar,
    period: Scalar,
    substeps: int,
    directions: Sequence[tuple[PlantState, Scalar]],
    ripple: Float[Array, " substeps"] | None = None,
) -> tuple[PlantState, list[PlantState]]:
    """`advance`, and its derivatives along each of some directions of state and force.

    All tangents are carried through one loop; the derivative of the loop would run it again for each direction.
    """
    plant = _plant_under_load(drive, load, period / substeps)
    push = plant.mobility * (force + drive.plant.constant_force)
    ripple_pushes, push_tangents = (
        _ripple_pushes(plant, ripple),
        [plant.mobility * push_tangent for _, push_tangent in directions],
    )

    def linearised(
        friction_velocity: Scalar,
        bristle: Scalar,
        under: Callable[..., _SubstepState],
        point: tuple[PyTree, ...],
        tangents: Sequence[tuple[Scalar, tuple[PyTree, ...]]],
    ) -> tuple[_SubstepState, tuple[_SubstepState, ...]]:
        """What is linear once the balance is known, and its tangents, each with that of the friction's velocity."""

        def at(velocity: Scalar) -> tuple[_SubstepState, _Balance]:
            balance = _balance(plant, velocity, bristle)
            return under(balance, *point), balance

        value, slope, balance = jax.jvp(at, (friction_velocity,), (jnp.ones_like(friction_velocity),), has_aux=True)

        def along(by_velocity: Scalar, tangent: tuple[PyTree, ...]) -> _SubstepState:
            return jax.tree.map(lambda linear, bent: linear + by_velocity * bent, under(balance, *tangent), slope)

        return value, tuple(along(*tangent) for tangent in tangents)

    def substep_under(balance: _Balance, *point: Any) -> _SubstepState:
        return _substep_under(balance, plant.step, *point)

    def body(carry: PyTree, ripple_push: tuple[Scalar, Scalar] | None) -> tuple[PyTree, None]:
        current, tangents = carry
        ahead = [
            (tangent.friction_velocity, (tangent, push_tangent, push_tangent))
            for tangent, push_tangent in zip(tangents, push_tangents, strict=True)
        ]
        point = (current, *_pushes(push, ripple_push))
        return linearised(current.friction_velocity, current.state.bristle, substep_under, point, ahead), None

    initial_tangents = [
        (state.velocity, (state, push_tangent))
        for (state, _), push_tangent in zip(directions, push_tangents, strict=True)
    ]
    first = (state, _first_push(push, ripple_pushes))
    begin = linearised(state.velocity, state.bristle, _begin_under, first, initial_tangents)
    (current, tangents), _ = lax.scan(body, begin, ripple_pushes, length=substeps)
    return current.state, [tangent.state for tangent in tangents]


def at_rest(position: Scalar) -> PlantState:
    """Standing still at `position`, bristle relaxed."""
    zero = jnp.zeros_like(jnp.asarray(position))
    return PlantState(jnp.asarray(position), zero, zero)
