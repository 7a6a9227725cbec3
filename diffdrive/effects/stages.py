"""A drive's effects at work: each stage of the control step, with whatever of them belongs there."""

import dataclasses
import functools
from typing import Any

import jax.numpy as jnp

from diffdrive.effects.actuator import ForceGain, ForceLimit
from diffdrive.effects.base import (
    Acts,
    ActuatorEffect,
    Effect,
    MachineEffect,
    Push,
    ScaleEffect,
    Seen,
    StepOrder,
    TableEffect,
)
from diffdrive.model.friction import friction_force, lugre_coefficients
from diffdrive.model.parameters import Directional, Drive, Sampling, Scalar

Effects = tuple[Effect, ...]


def with_machine_effects(drive: Drive, effects: Effects) -> Drive:
    """The drive with the effects that are other parameters."""
    for effect in effects:
        if isinstance(effect, MachineEffect):
            drive = effect.alter(drive)
    return drive


def initial_states(effects: Effects, force: Scalar) -> tuple[Any, ...]:
    """The state of every effect at rest, the actuator's after a long time at `force` (N)."""
    return tuple(_begin(effect, force) for effect in effects)


def _begin(effect: Effect, force: Scalar) -> Any:
    if isinstance(effect, ActuatorEffect):
        return effect.init(force)
    return effect.init() if isinstance(effect, TableEffect) else ()


def actuator_output(
    effects: Effects, states: tuple[Any, ...], force: Scalar, period: float
) -> tuple[tuple[Any, ...], Push]:
    """What comes out of the actuator when `force` (N) is asked of it."""
    ahead, push = list(states), Push(force)
    chain = [(effect.stage, k, effect) for k, effect in enumerate(effects) if isinstance(effect, ActuatorEffect)]
    for _, k, effect in sorted(chain, key=lambda one: one[:2]):
        ahead[k], own = effect.step(states[k], push.mean, period)
        push = Push(own.mean, push.slope + own.slope)
    return tuple(ahead), push


def force_limit(drive: Drive) -> Scalar | None:
    """The largest command that is not cut off (N): the drive's own limit, or an effect's where that is less.

    An effect limits the force that a `ForceGain` has scaled, the drive its command.
    """
    gain = functools.reduce(
        lambda gain, effect: gain * jnp.abs(1.0 + effect.gain),
        [effect for effect in drive.effects if isinstance(effect, ForceGain)],
        1.0,
    )
    limits = [effect.limit / gain for effect in drive.effects if isinstance(effect, ForceLimit)]
    if drive.actuator.force_limit is not None:
        limits.append(drive.actuator.force_limit)
    return functools.reduce(jnp.minimum, limits) if limits else None


def plant_substeps(effects: Effects, sampling: Sampling) -> int:
    """Substeps of the plant: as many as were asked for; by default no more than an effect takes that integrates the
    table itself.
    """
    own = [effect.substeps(sampling.period) for effect in effects if isinstance(effect, TableEffect)]
    least = min((count for count in own if count is not None), default=sampling.plant_steps)
    return sampling.plant_steps if sampling.substeps else min(least, sampling.plant_steps)


def slope_displacement(drive: Drive, tilt: Scalar, period: float) -> Scalar:
    """How much further (m) a force of this tilt carries the table in a period than its mean."""
    return -tilt * period**2 / (12.0 * drive.plant.mass)


def table_action(
    effects: Effects, states: tuple[Any, ...], seen: Seen, drive: Drive, period: float
) -> tuple[tuple[Any, ...], Acts]:
    """What acts on the table and its friction over the coming period."""
    return table_action_in_order(effects, states, seen, drive, period)[:2]


def table_action_in_order(
    effects: Effects, states: tuple[Any, ...], seen: Seen, drive: Drive, period: float
) -> tuple[tuple[Any, ...], Acts, tuple[Seen, Drive]]:
    """`table_action`, and the table and the drive as an effect that comes after all of these sees them.

    What an effect is to know of the others, those of an earlier `StepOrder` tell it: what they push, and how they bend
    the friction.
    """
    ahead, total, before = list(states), Acts(), (seen, drive)
    for place in StepOrder:
        mine = [k for k, effect in enumerate(effects) if isinstance(effect, TableEffect) and effect.order == place]
        for k in mine:
            ahead[k], acts = effects[k].step(states[k], *before, period)
            total = total.plus(acts)
        if mine:
            machine = with_friction_offset(drive, total)
            friction = resistance(machine, seen.velocity, seen.bristle, seen.load)
            before = (seen._replace(push=seen.push + total.force, friction=friction), machine)
    return tuple(ahead), total, before


def scale_error(effects: Effects, position: Scalar) -> Scalar:
    """How far the scale is off (m)."""
    errors = [effect.error(position) for effect in effects if isinstance(effect, ScaleEffect)]
    return sum(errors[1:], errors[0]) if errors else 0.0 * position


def with_friction_offset(drive: Drive, acts: Any) -> Drive:
    """The drive with its friction as `acts` bends it."""

    def more(pair: Directional, by: Scalar) -> Directional:
        return Directional(pair.positive + by, pair.negative + by)

    friction = drive.friction
    return dataclasses.replace(
        drive,
        friction=dataclasses.replace(
            friction,
            coulomb_screw=more(friction.coulomb_screw, acts.coulomb),
            breakaway_gap=more(friction.breakaway_gap, acts.gap),
            viscous=more(friction.viscous, acts.viscous),
        ),
    )


def resistance(drive: Drive, velocity: Scalar, bristle: Scalar, load: Scalar) -> Scalar:
    """All that resists the table (N): friction and damping."""
    sliding = friction_force(lugre_coefficients(drive.friction, velocity, bristle, load), velocity, bristle)
    return sliding + drive.plant.damping.towards(velocity) * velocity


def seen_by(
    drive: Drive,
    time: Scalar,
    position: Scalar,
    velocity: Scalar,
    bristle: Scalar,
    force: Scalar,
    push: Scalar,
    load: Scalar,
) -> Seen:
    """The table as effects see it."""
    resisting = resistance(drive, velocity, bristle, load)
    return Seen(time, position, velocity, bristle, force, resisting, jnp.asarray(load), push)
