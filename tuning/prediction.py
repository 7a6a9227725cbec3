"""One-step prediction of a log by a drive: what the model did not foresee, sample by sample.

The drive is given the command that the log holds, so that the noise in the machine's loop reaches it too, and is pulled
towards the measured position by an observer of bandwidth w (rad/s):

    e = y - x ,   x <- x + (1 - q^2) e ,   v <- v + (1 - q)^2 / T e ,   q = exp(-w T)

which puts both poles of a free mass at q. e is the innovation. With w -> 0 it is the open-loop simulation of the logged
command, best for an exact model and lost for any other; a larger w forgives what the model lacks. Where w is fitted with the
parameters, it finds how far the model can be trusted (the innovation form of the prediction-error method: Ljung,
System Identification, ch. 7).
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive import plant
from diffdrive.actuator import limited
from diffdrive.parameters import Drive, Sampling, Scalar, require_double_precision


class Lanes(NamedTuple):
    """Stretches of logs side by side, [lanes, n] each; shorter ones are padded at the end, where `counts` is 0."""

    position: Float[Array, "lanes n"]  # m
    command: Float[Array, "lanes n"]  # N
    disturbance: Float[Array, "lanes n"]  # N
    load: Float[Array, "lanes n"]  # N
    counts: Float[Array, "lanes n"]
    velocity: Float[Array, " lanes"]  # m/s, at the first sample

    @property
    def samples(self) -> int:
        """How many samples count."""
        return int(np.sum(np.asarray(self.counts)))


class Observer(eqx.Module):
    """What the prediction needs beside the drive: its bandwidth, the loop's delay, and where each stretch began."""

    bandwidth: Scalar  # rad/s
    delay: Scalar  # control periods between command and force
    bristle_force: Float[Array, " lanes"]  # N, that the bent bristle exerted at the first sample


LONGEST_DELAY = 4  # control periods
EARLIEST_DELAY = -1  # a command that is logged one sample late


def delayed(command: Float[Array, " n"], delay: Scalar) -> Float[Array, " n"]:
    """The command `delay` periods later, linear between samples; before the log its first value."""
    shifted = jnp.zeros_like(command)
    for periods in range(EARLIEST_DELAY, LONGEST_DELAY + 1):
        share = jnp.maximum(0.0, 1.0 - jnp.abs(delay - periods))
        if periods >= 0:
            past = jnp.concatenate([jnp.full(periods, command[0]), command[: len(command) - periods]])
        else:
            past = jnp.concatenate([command[-periods:], jnp.full(-periods, command[-1])])
        shifted = shifted + share * past
    return shifted


class Predicted(NamedTuple):
    """What was predicted, [n] each."""

    innovation: Scalar  # m, measured minus predicted position
    velocity: Scalar  # m/s, after the correction
    bristle: Scalar  # m


def predict(drive: Drive, observer: Observer, lanes: Lanes, sampling: Sampling) -> Predicted:
    """Predict each lane; arrays of shape [lanes, n]. Pure: for use under `jit`, `vmap` and `jacfwd`.

    The drive's own delay is not used: the observer's is.
    """
    require_double_precision()
    period = sampling.period
    fade = jnp.exp(-observer.bandwidth * period)
    to_position, to_velocity = 1.0 - fade**2, (1.0 - fade) ** 2 / period

    def lane(stretch: Lanes, bristle_force: Scalar) -> Predicted:
        force = delayed(limited(drive.actuator, stretch.command), observer.delay) + stretch.disturbance
        stiffness = drive.friction.bristle_stiffness.towards(bristle_force)

        def body(state: plant.PlantState, at: tuple[Scalar, Scalar, Scalar]) -> tuple[plant.PlantState, Predicted]:
            measured, acting, load = at
            innovation = measured - state.position
            state = plant.PlantState(
                state.position + to_position * innovation, state.velocity + to_velocity * innovation, state.bristle
            )
            state = lax.optimization_barrier(state)
            ahead = plant.advance(drive, state, acting, load, period, sampling.plant_steps)
            return ahead, Predicted(innovation, state.velocity, state.bristle)

        begin = plant.PlantState(stretch.position[0], stretch.velocity, bristle_force / stiffness)
        return lax.scan(body, begin, (stretch.position, force, stretch.load))[1]

    return jax.vmap(lane)(lanes, observer.bristle_force)
