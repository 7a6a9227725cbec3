"""The closed loop, one control step at a time.

    encoders -> controller (with its observer) -> command -> actuator -> force -> plant -> ...

A step begins where a controller's interrupt routine begins, with the measurement; the estimate used at k rests on
the measurement at k and on the force applied up to k, so there is no algebraic loop.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from diffdrive.controllers import Controller, Reference
from diffdrive.effects import stages
from diffdrive.effects.base import Push
from diffdrive.loop.encoders import Count, read_encoders
from diffdrive.model import actuator, plant
from diffdrive.model.friction import friction_force, lugre_coefficients
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar, in_precision_of
from diffdrive.numerics.once import once
from diffdrive.observers.friction_observer import ObserverEstimate


class Inputs(NamedTuple):
    """The inputs of the loop, [n] over time or scalars at one step."""

    reference: Reference
    load: Float[Array, " n"] | Scalar  # N on the guides
    disturbance: Float[Array, " n"] | Scalar  # N on the table beside the actuator's: process force, test pulses


class Frame(NamedTuple):
    """The recorded signals of one control step: those at sample k, and the command issued at k."""

    table_position: Scalar  # m, true
    velocity: Scalar  # m/s
    measured: Scalar  # m, as the scale reports it
    command: Scalar  # N, before the actuator
    force: Scalar  # N, that acts from k to k+1
    friction: Scalar  # N, without the damping B_S v
    estimate: ObserverEstimate | None
    motor_position: Scalar | None = None  # m, as the motor encoder reports it


class LoopState(NamedTuple):
    """The state that is carried from one control step to the next."""

    plant: plant.PlantState
    actuator: actuator.ActuatorState
    controller: PyTree
    count: Count  # type: ignore[assignment]  # hides `tuple.count`, which a state does not need
    effects: tuple[PyTree, ...] = ()


def initial_state(drive: Drive, controller: Controller, position: Scalar) -> LoopState:
    """Everything at rest at `position` (m), in its precision."""
    state = LoopState(
        plant.at_rest(position),
        actuator.init(drive.actuator),
        controller.init(position),
        jnp.zeros((), jnp.uint32),
        stages.initial_states(drive.effects, jnp.zeros(())),
    )
    return in_precision_of(position, state)


def step_machine(
    drive: Drive, sampling: Sampling, state: LoopState, push: Push, disturbance: Scalar, load: Scalar
) -> tuple[plant.PlantState, tuple[PyTree, ...], Drive]:
    """One period of the table under the actuator's `push`, a `disturbance` and a `load` (N).

    `drive` has its machine effects in it. Returns the table, the states of the effects, and the drive with the friction
    that the effects cause over that period.
    """
    table, effects, force = state.plant, drive.effects, push.mean + disturbance
    if not effects:
        return plant.advance(drive, table, force, load, sampling.period, sampling.plant_steps), (), drive
    time = sampling.period * state.count
    seen = stages.seen_by(drive, time, table.position, table.velocity, table.bristle, push.mean, disturbance, load)
    effect_states, acts = stages.table_action(effects, state.effects, seen, drive, sampling.period)
    effect_states, acts = once((effect_states, acts))
    machine = stages.with_friction_offset(drive, acts)
    steps = stages.plant_substeps(effects, sampling)
    moved = plant.advance(machine, table, force + acts.force, load, sampling.period, steps)
    shift = acts.shift + stages.slope_displacement(drive, push.slope, sampling.period)
    return moved._replace(position=moved.position + shift), effect_states, machine


def step(
    drive: Drive, controller: Controller, sampling: Sampling, key: Array | None, state: LoopState, inputs: Inputs
) -> tuple[LoopState, Frame]:
    """One control period of the closed loop of a drive that has its machine effects in it."""
    table = state.plant
    encoders = read_encoders(drive, table.position, state.effects, key, state.count)
    controller_state, command = controller.step_from_encoders(
        state.controller, inputs.reference, encoders, state.actuator.applied, sampling.period
    )
    controller_state, command = once((controller_state, command))
    drive_state = actuator.step(drive.actuator, state.actuator, command.force, sampling.period)
    effect_states, applied = stages.actuator_output(drive.effects, state.effects, drive_state.applied, sampling.period)
    before = state._replace(effects=effect_states)
    moved, effect_states, machine = step_machine(drive, sampling, before, applied, inputs.disturbance, inputs.load)
    coefficients = lugre_coefficients(machine.friction, table.velocity, table.bristle, inputs.load)
    frame = Frame(
        table_position=table.position,
        velocity=table.velocity,
        measured=encoders.scale,
        command=command.force,
        force=applied.mean,
        friction=friction_force(coefficients, table.velocity, table.bristle),
        estimate=command.estimate,
        motor_position=encoders.motor,
    )
    return LoopState(moved, drive_state, controller_state, state.count + 1, effect_states), frame
