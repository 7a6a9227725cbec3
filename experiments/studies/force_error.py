"""A drive with effects by inverse dynamics: the force that it would have taken to move as a log does.

    M a + friction - constant_force - what the effects add = command + disturbance

with velocity and acceleration from the filtered position, both sides decimated to the band of the dynamics
(tuning/identification/inverse_dynamics.py). The force is held over a period, so that the acceleration at a sample
belongs to the mean of the forces before and after it.
"""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from diffdrive.effects import stages
from diffdrive.effects.base import Acts
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import as_arrays
from tuning.diagnosis.filter.effect_signals import Trajectory, effect_signals
from tuning.identification.friction_along import friction_along
from tuning.identification.inverse_dynamics import DYNAMICS
from tuning.identification.prediction import Lanes
from tuning.identification.problem import sampling_of
from tuning.identification.stretches import Stretch, stretches
from tuning.identification.zero_phase import decimate, differentiate


def force_error(drive: Drive, log: Log, dynamics: float = DYNAMICS, of: Log | None = None) -> float:
    """100 |force - model| / |force| up to `dynamics` (Hz), of the force of this log or of another, `of`.

    Raises `LogError` where no piece is long enough.
    """
    off = np.concatenate([_off(drive, log, one, dynamics) for one in stretches([log], dynamics)[0]])
    there = stretches([of or log], dynamics)[0]
    force = np.concatenate([_decimated(one.force, one, dynamics) for one in there])
    return 100.0 * float(np.linalg.norm(off) / np.linalg.norm(force))


def _decimated(signal: np.ndarray | Array, source: Stretch, dynamics: float) -> np.ndarray:
    """A signal of a stretch without what the filters spoil."""
    ratio = max(1, round(0.8 * source.rate / 2 / (2 * dynamics)))
    return decimate(np.asarray(signal)[source.border : len(signal) - source.border], ratio)


def _off(drive: Drive, log: Log, source: Stretch, dynamics: float) -> np.ndarray:
    """What the model's force is off by."""
    drive = as_arrays(drive)
    own, effects = dataclasses.replace(drive, effects=()), drive.effects
    velocity, acceleration = (jnp.asarray(one) for one in differentiate(source.position, source.rate, 5 * dynamics))
    command = log.command[np.searchsorted(log.time, source.time)]
    position, load = jnp.asarray(source.position), jnp.asarray(source.load)
    disturbance = jnp.asarray(source.force - command)
    ones = jnp.ones_like(load)
    lanes = Lanes(position[None], jnp.asarray(command)[None], disturbance[None], load[None], ones[None], velocity[:1])
    machine = stages.with_machine_effects(own, effects)
    period = 1.0 / source.rate
    rigid = friction_along(machine, velocity, load, period)
    seen = Trajectory(position, velocity, rigid.bristle, rigid.friction, jnp.zeros_like(velocity))
    trajectory = jax.tree.map(lambda signal: signal[None], seen)
    in_lanes = jax.tree.map(lambda leaf: jnp.asarray(leaf)[None], effects)
    delay = jnp.asarray(own.actuator.delay_samples + float(own.actuator.delay_fraction or 0.0))
    begins = jnp.asarray([float(source.time[0] - log.time[0])])
    acts = effect_signals(own, in_lanes, delay, lanes, trajectory, sampling_of(source.rate, period), begins)
    none = jnp.zeros_like(velocity)
    bent = Acts(none, acts.coulomb[0], acts.gap[0], acts.viscous[0], none)
    needed = machine.plant.mass * acceleration + friction_along(machine, velocity, load, period, bent).friction
    there = acts.force[0] + machine.plant.constant_force
    held = 0.5 * (there + jnp.concatenate([there[:1], there[:-1]]))
    return _decimated(held - needed, source, dynamics)
