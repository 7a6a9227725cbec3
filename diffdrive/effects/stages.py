"""The stages of the control step at which a drive's effects act."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import PyTree

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
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar

Effects = tuple[Effect, ...]


def with_machine_effects(drive: Drive, effects: Effects) -> Drive:
    """The drive with its machine effects applied to its parameters."""
    for effect in effects:
        if isinstance(effect, MachineEffect):
            drive = effect.alter(drive)
    return drive


def initial_states(effects: Effects, force: Scalar) -> tuple[PyTree, ...]:
    """The state of every effect at rest, those of the actuator after a long time at `force` (N)."""
    return tuple(_initial_state(effect, force) for effect in effects)


def _initial_state(effect: Effect, force: Scalar) -> PyTree:
    if isinstance(effect, ActuatorEffect):
        return effect.init(force)
    return effect.init() if isinstance(effect, TableEffect) else ()


def actuator_output(
    effects: Effects, states: tuple[PyTree, ...], force: Scalar, period: float
) -> tuple[tuple[PyTree, ...], Push]:
    """The states and the force of the actuator over a `period` (s) in which `force` (N) is requested."""
    next_states, push = list(states), Push(force)
    for k, effect in _actuator_chain(effects):
        next_states[k], output = effect.step(states[k], push.mean, period)
        push = Push(output.mean, push.slope + output.slope)
    return tuple(next_states), push


def _actuator_chain(effects: Effects) -> list[tuple[int, ActuatorEffect]]:
    """The effects between command and force in the order of the signal, each with its place among all."""
    chain = [(k, effect) for k, effect in enumerate(effects) if isinstance(effect, ActuatorEffect)]
    return sorted(chain, key=lambda entry: entry[1].stage)


def force_limit(drive: Drive) -> Scalar | None:
    """The largest command that is not limited (N): the smaller of the drive's and the effects' limits; None without."""
    limit: Scalar | None = None
    for _, effect in reversed(_actuator_chain(drive.effects)):
        limit = effect.input_limit(limit)
    own = drive.actuator.force_limit  # of the command, before any effect
    return own if limit is None else limit if own is None else jnp.minimum(limit, own)


def plant_substeps(effects: Effects, sampling: Sampling) -> int:
    """Substeps of the plant in a period: those of `sampling`, by default no more than an effect's integrator has."""
    required = [effect.substeps(sampling.period) for effect in effects if isinstance(effect, TableEffect)]
    fewest = min((count for count in required if count is not None), default=sampling.plant_steps)
    return sampling.plant_steps if sampling.substeps else min(fewest, sampling.plant_steps)


def slope_displacement(drive: Drive, slope: Scalar, period: float) -> Scalar:
    """The displacement (m) in a period under a force of this slope beyond that under its mean."""
    return -slope * period**2 / (12.0 * drive.plant.mass)


def table_action(
    effects: Effects, states: tuple[PyTree, ...], seen: Seen, drive: Drive, period: float
) -> tuple[tuple[PyTree, ...], Acts]:
    """The states after the coming period, and what the effects add to force and friction over it."""
    return table_action_in_order(effects, states, seen, drive, period)[:2]


def table_action_in_order(
    effects: Effects, states: tuple[PyTree, ...], seen: Seen, drive: Drive, period: float
) -> tuple[tuple[PyTree, ...], Acts, tuple[Seen, Drive]]:
    """`table_action`, and the inputs (table, drive) of an effect that is stepped after all of these.

    An effect's inputs contain the forces and the friction of those with an earlier `StepOrder`.
    """
    next_states, total, inputs = list(states), Acts(), (seen, drive)
    for order in StepOrder:
        members = [
            (k, effect) for k, effect in enumerate(effects) if isinstance(effect, TableEffect) and effect.order == order
        ]
        for k, effect in members:
            next_states[k], acts = effect.step(states[k], *inputs, period)
            total = total.plus(acts)
        if members:
            machine = with_friction_offset(drive, total)
            friction = resistance(machine, seen.velocity, seen.bristle, seen.load)
            inputs = (seen._replace(push=seen.push + total.force, friction=friction), machine)
    return tuple(next_states), total, inputs


def scale_error(effects: Effects, position: Scalar) -> Scalar:
    """The error of the scale (m) where the table is at `position` (m)."""
    errors = [effect.error(position) for effect in effects if isinstance(effect, ScaleEffect)]
    return sum(errors[1:], errors[0]) if errors else 0.0 * position


def of_screw(effects: Effects) -> Effects:
    """The errors of the measured position that arise between motor and table: those of a motor encoder."""
    return tuple(effect for effect in effects if isinstance(effect, ScaleEffect) and effect.of_screw)


def of_scale(effects: Effects) -> Effects:
    """The errors of the measured position that arise at the table: those of a scale beside a motor encoder."""
    return tuple(effect for effect in effects if isinstance(effect, ScaleEffect) and not effect.of_screw)


def motor_deflection(effects: Effects, states: tuple[PyTree, ...]) -> Scalar:
    """How far the motor is ahead of the table (m)."""
    pairs = zip(effects, states, strict=True)
    deflections = [effect.motor_deflection(state) for effect, state in pairs if isinstance(effect, TableEffect)]
    return sum(deflections[1:], deflections[0]) if deflections else 0.0


def with_friction_offset(drive: Drive, acts: PyTree) -> Drive:
    """The drive with the friction that the effects add."""
    friction = drive.friction
    return dataclasses.replace(
        drive,
        friction=dataclasses.replace(
            friction,
            coulomb_screw=friction.coulomb_screw + acts.coulomb,
            breakaway_gap=friction.breakaway_gap + acts.gap,
            viscous=friction.viscous + acts.viscous,
        ),
    )


def resistance(drive: Drive, velocity: Scalar, bristle: Scalar, load: Scalar) -> Scalar:
    """Friction and damping of the table (N)."""
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
