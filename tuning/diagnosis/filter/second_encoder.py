"""A second encoder before the screw: it sees how far the motor is from the table, which the first cannot.

A fitted hypothesis foresees that twist: a compliant or loose screw by the motor's deflection that its filter takes the
table to tell, an error of the scale by what the scale is off. The others foresee none. How much likelier the measured
twist is for it counts as evidence; the offset between the encoders is free.
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from diffdrive.effects.base import Effect, ScaleEffect
from diffdrive.logs import Log
from tuning.diagnosis.filter.ekf import EkfResult
from tuning.identification.prediction import Lanes
from tuning.identification.problem import long_pieces

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


def predicted_twist(effects: Sequence[Effect], filtered: EkfResult) -> Float[np.ndarray, "lanes n"]:
    """The twist (m) that effects, whose parameters are given by lane, make along what was filtered."""
    total = (
        np.zeros(filtered.innovation.shape)
        if filtered.motor_deflection is None
        else np.array(filtered.motor_deflection)
    )
    for effect in effects:
        if isinstance(effect, ScaleEffect):
            total -= np.asarray(jax.vmap(type(effect).error)(effect, filtered.trajectory.position))
    return total


def twist_deviance(twist: Twist, expected: Float[np.ndarray, "lanes n"], period: float) -> float:
    """-2 log likelihood of the twist against that of none at all; below zero where the expected one is there.

    Zero where it was not measured, as in a log without a second encoder among others that have one.
    """
    if not twist.counts.any():
        return 0.0
    independent = float(twist.counts.sum()) * min(1.0, period / INDEPENDENT)
    return independent * float(np.log(_squares(twist, twist.value - expected) / _squares(twist, twist.value)))


def seen_by(
    twist: Twist, added: Float[np.ndarray, "lanes n"], expected: Float[np.ndarray, "lanes n"], period: float
) -> Float[np.ndarray, " m"]:
    """What a small twist that is `added` to the one `expected` counts as residuals: `twist_deviance` falls by its
    squares where the machine has it.
    """
    independent = float(twist.counts.sum()) * min(1.0, period / INDEPENDENT)
    weight = np.sqrt(independent / _squares(twist, twist.value - expected))
    return (weight * _about_mean(twist, added) * twist.counts).ravel()


def _about_mean(twist: Twist, signal: Float[np.ndarray, "lanes n"]) -> Float[np.ndarray, "lanes n"]:
    each = np.maximum(twist.counts.sum(axis=1, keepdims=True), 1.0)
    return signal - np.sum(signal * twist.counts, axis=1, keepdims=True) / each


def _squares(twist: Twist, rest: Float[np.ndarray, "lanes n"]) -> float:
    return float(np.sum((_about_mean(twist, rest) ** 2 + twist.noise**2) * twist.counts))
