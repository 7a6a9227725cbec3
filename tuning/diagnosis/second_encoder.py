"""A second encoder before the screw: it sees how far the motor is from the table, which the first cannot.

A fitted hypothesis foresees that twist: a compliant or loose screw by its motor's deflection along the course, an error
of the scale by what the scale is off. The others foresee none. How much likelier the measured twist is for it counts as
evidence; the offset between the encoders is free.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive.effects import acting
from diffdrive.effects.base import Effect, ScaleEffect
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.logs import Log
from diffdrive.parameters import Drive, Sampling
from tuning.diagnosis.following import Course, Exposure
from tuning.prediction import Lanes
from tuning.replay import long_pieces

INDEPENDENT = 5e-3  # s: residuals of a twist that a model does not foresee hang together so long, at least


class Twist(NamedTuple):
    """Motor minus table where both were measured; [lanes, n] each."""

    value: Float[np.ndarray, "lanes n"]  # m
    counts: Float[np.ndarray, "lanes n"]
    noise: float  # m, standard deviation


def twist_of(logs: Sequence[Log], lanes: Lanes, noise: float, thinning: int = 1) -> Twist | None:
    """The twist of lanes made from `logs`, thinned so, whose positions scatter by `noise` (m).

    None without a second encoder.
    """
    value = np.zeros(lanes.position.shape)
    there = np.zeros(lanes.position.shape)
    rows = [(log, piece) for log in logs for piece in long_pieces(log)]
    for lane, (log, piece) in enumerate(rows):
        if log.motor_position is not None:
            twist = (log.motor_position[piece] - log.position[piece])[::thinning]
            n = min(len(twist), value.shape[1])
            value[lane, :n] = twist[:n]
            there[lane, :n] = 1.0
    counts = there * np.asarray(lanes.counts)
    if not counts.any():
        return None
    return Twist(value, counts, float(np.sqrt(2.0) * noise))


@eqx.filter_jit
def _deflection(
    effect: Effect, drive: Drive, under: Exposure, lanes: Lanes, course: Course, sampling: Sampling
) -> Float[Array, "lanes n"]:
    """The motor's deflection (m) against the table at each sample, of an effect whose parameters are given by lane."""

    def one(effect: Any, under: Exposure, lane: Lanes, course: Course) -> Float[Array, " n"]:
        def step(state: Any, at: Any) -> tuple[Any, Array]:
            count, acts, load, table = at
            seen = acts.seen(count * sampling.period, table, load)
            return effect.step(state, seen, acting.bent(drive, acts), sampling.period)[0], state.against.deflection

        count = jnp.arange(len(lane.load), dtype=lane.load.dtype)
        return lax.scan(step, effect.init(), (count, under, lane.load, course))[1]

    return lax.map(lambda each: one(*each), (effect, under, lanes, course))


def foreseen(
    effects: Sequence[Effect], drive: Drive, under: Exposure, lanes: Lanes, course: Course, sampling: Sampling
) -> Float[np.ndarray, "lanes n"]:
    """The twist (m) that effects, whose parameters are given by lane, make along a course."""
    total = np.zeros(lanes.position.shape)
    for effect in effects:
        if isinstance(effect, Compliance | Backlash):
            total += np.asarray(_deflection(effect, drive, under, lanes, course, sampling))
        elif isinstance(effect, ScaleEffect):
            total -= np.asarray(jax.vmap(type(effect).error)(effect, course.position))
    return total


def unlikelihood(twist: Twist, expected: Float[np.ndarray, "lanes n"], period: float) -> float:
    """-2 log likelihood of the twist against that of none at all; below zero where the expected one is there.

    Zero where it was not measured, as in a log without a second encoder among others that have one.
    """
    if not twist.counts.any():
        return 0.0

    def squares(rest: Float[np.ndarray, "lanes n"]) -> float:
        each = np.maximum(twist.counts.sum(axis=1, keepdims=True), 1.0)
        about = rest - np.sum(rest * twist.counts, axis=1, keepdims=True) / each
        return float(np.sum((about**2 + twist.noise**2) * twist.counts))

    independent = float(twist.counts.sum()) * min(1.0, period / INDEPENDENT)
    return independent * float(np.log(squares(twist.value - expected) / squares(twist.value)))
