"""What acts on the table along a trajectory: most effects, and the command that they make of another force.

Stepped along where the table went in the last pass, what an effect does is a signal like any other, whatever it is: one
compiled filter (`ekf`) serves them all. Those in a loop with the table's velocity and friction are
stepped within it.
"""

from collections.abc import Callable
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.effects import stages
from diffdrive.effects.actuator import ActuatorLag, LoopDelay
from diffdrive.effects.base import ActuatorEffect, Effect, Push, Seen
from diffdrive.model.actuator import saturate
from diffdrive.model.current_loop import mean_forces
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from tuning.identification.prediction import Lanes


class EffectSignals(NamedTuple):
    """What acts on the table over each period, and how far the scale is off; [lanes, n] each."""

    force: Float[Array, "lanes n"]  # N
    coulomb: Float[Array, "lanes n"]  # N
    gap: Float[Array, "lanes n"]  # N
    viscous: Float[Array, "lanes n"]  # N s/m
    shift: Float[Array, "lanes n"]  # m, that the force's shape within the period adds to the motion
    scale: Float[Array, "lanes n"]  # m
    beside: Float[Array, "lanes n"]  # N, share of `force` that does not come from the motor
    # N, in each control period of a sample, of the force about its mean
    ripple: Float[Array, "lanes n k"] | None = None

    def seen(self, time: Scalar, trajectory: "Trajectory", load: Scalar) -> Seen:
        """One sample of it, at one of a trajectory, as coupled effects see it."""
        position, velocity, bristle, friction, disturbance = trajectory
        force = self.force - self.beside
        return Seen(time, position, velocity, bristle, force, friction, load, self.beside, self.ripple, disturbance)


class Trajectory(NamedTuple):
    """Where the table went, as effects are to see it; [lanes, n] each."""

    position: Float[Array, "lanes n"]  # m
    velocity: Float[Array, "lanes n"]  # m/s
    bristle: Float[Array, "lanes n"]  # m
    friction: Float[Array, "lanes n"]  # N, all that resists
    disturbance: Float[Array, "lanes n"]  # N, force that the model lacks


def altered(drive: Drive, effects: tuple[Effect, ...]) -> Drive:
    """The drive with the effects that are other parameters; those are the same in every lane."""
    return stages.with_machine_effects(drive, jax.tree.map(lambda leaf: leaf[0], effects))


def effect_signals(
    drive: Drive,
    effects: tuple[Effect, ...],
    delay: Scalar,
    lanes: Lanes,
    trajectory: Trajectory,
    sampling: Sampling,
    starts: Float[Array, " lanes"],
    ahead: float = 0.0,
) -> EffectSignals:
    """What the effects, whose parameters are given for each lane, do along a trajectory that starts at `starts` (s).

    `ahead` is by how many samples a command may act before its row, as those of snapshots may.
    """
    machine = altered(drive, effects)
    period = sampling.period

    def one(lane: Lanes, trajectory: Trajectory, effects: tuple[Effect, ...], start: Scalar) -> EffectSignals:
        effects, requested = _requested(drive, effects, delay, lane, sampling, ahead)
        parts = requested.shape[1]
        push = _pushes(effects, requested, period / parts)
        mean, slope = jnp.asarray(push.mean), jnp.asarray(push.slope)
        force = jnp.sum(mean, axis=1) / parts
        shift = jnp.sum(stages.slope_displacement(machine, slope, period / parts), axis=1)
        # of each substep, so that a delay, which needs those, runs in the filter that is compiled already
        held = sampling.plant_steps // parts  # substeps
        ripple = jnp.repeat(mean - force[:, None], held, axis=1) if parts > 1 else None
        others = tuple(effect for effect in effects if not isinstance(effect, ActuatorEffect))

        def step(states: tuple[PyTree, ...], at: PyTree) -> tuple[tuple[PyTree, ...], tuple[Scalar, ...]]:
            count, table, force, shift, pushed, load = at
            seen = Seen(
                start + count * period, table.position, table.velocity, table.bristle, force, table.friction, load,
                pushed, disturbance=table.disturbance,
            )  # fmt: skip
            states, acts = stages.table_action(others, states, seen, machine, period)
            scale = stages.scale_error(others, table.position)
            beside = pushed + acts.force
            found = (force + beside, acts.coulomb, acts.gap, acts.viscous, acts.shift + shift, scale, beside)
            return states, tuple(value + 0.0 * force for value in found)

        count = jnp.arange(len(requested), dtype=requested.dtype)
        signals = (count, trajectory, force, shift, lane.disturbance, lane.load)
        return EffectSignals._make((*_along(step, stages.initial_states(others, requested[0, 0]), signals), ripple))

    return lax.map(lambda each: one(*each), (lanes, trajectory, effects, starts))


def _pushes(effects: tuple[Effect, ...], requested: Float[Array, "n parts"], part: float) -> Push:
    """What the actuator does of the force requested in each part (s) of each sample, [n, parts] each.

    A loop of its own over all parts: written out within each sample, forty of them take the compiler many GB.
    """
    chain = tuple(effect for effect in effects if isinstance(effect, ActuatorEffect))

    def step(states: tuple[PyTree, ...], force: Scalar) -> tuple[tuple[PyTree, ...], Push]:
        states, push = stages.actuator_output(chain, states, force, part)
        return states, Push(push.mean, push.slope + 0.0 * push.mean)

    found = _along(step, stages.initial_states(chain, requested[0, 0]), requested.reshape(-1))
    return jax.tree.map(lambda one: one.reshape(requested.shape), found)


def _along(step: Callable[[PyTree, PyTree], tuple[PyTree, PyTree]], states: PyTree, signals: PyTree) -> PyTree:
    """The results of `step` from sample to sample; all at once where nothing is remembered."""
    if not jax.tree.leaves(states):
        return jax.vmap(lambda at: step(states, at)[1])(signals)
    return lax.scan(step, states, signals)[1]


def _requested(
    drive: Drive, effects: tuple[Effect, ...], delay: Scalar, lane: Lanes, sampling: Sampling, ahead: float
) -> tuple[tuple[Effect, ...], Float[Array, "n k"]]:
    """The effects that have yet to act on it, and the force requested of the actuator in each part of each sample.

    A part is a control period, or a substep of the plant where the force changes within one: late or lagging, it does.
    In the mean over a whole period it would be spread over it, and a fine scale tells that from a delay. Delays, which
    are counted in samples, hold the command back here.
    """
    requested = in_parts(lane.command, 1) if lane.period_commands is None else lane.period_commands
    if any(isinstance(effect, LoopDelay | ActuatorLag) for effect in effects):
        requested = jnp.repeat(requested, sampling.plant_steps // requested.shape[1], axis=1)
    count, parts = requested.shape
    late = delay + sum(effect.delay for effect in effects if isinstance(effect, LoopDelay))
    limited = cast(Array, saturate(drive.actuator, requested.reshape(-1)))  # of an array, it is one
    applied = mean_forces(drive.actuator, limited, sampling.period / parts)
    force = _held_back(applied, jnp.maximum(late, -ahead) * parts)
    return tuple(effect for effect in effects if not isinstance(effect, LoopDelay)), force.reshape(count, parts)


def in_parts(command: Float[Array, "*lanes n"], parts: int) -> Float[Array, "*lanes n k"]:
    """A command that is held over each sample, part by part."""
    return jnp.repeat(command[..., None], parts, axis=-1)


def _held_back(force: Float[Array, " n"], periods: Scalar) -> Float[Array, " n"]:
    """The force that many periods later, linear between samples."""
    whole = lax.stop_gradient(jnp.floor(periods))
    before = jnp.arange(len(force)) - whole.astype(int)
    later, sooner = (force[jnp.clip(one, 0, len(force) - 1)] for one in (before, before - 1))
    return later + (periods - whole) * (sooner - later)
