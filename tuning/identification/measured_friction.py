"""The friction force that a log shows, given the mass: command + disturbance + constant_force - M a.

Everything is low-passed alike and without phase, so that the inertia force of a smooth motion cancels. What is left is
friction and damping together, smeared over about half a period of the filter.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from tuning.identification.stretches import Stretch, stretches
from tuning.identification.zero_phase import differentiate, lowpass

Signal = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class MeasuredFriction:
    """Friction along one stretch of a log: arrays of shape [n], low-passed."""

    log: str
    rate: float  # Hz
    time: Signal  # s
    position: Signal  # m
    velocity: Signal  # m/s
    acceleration: Signal  # m/s2
    friction: Signal  # N, damping included
    load: Signal  # N


def measured_friction(
    logs: Log | Sequence[Log], drive: Drive, dynamics: float
) -> tuple[list[MeasuredFriction], tuple[str, ...]]:
    """Friction along each stretch of `logs`, low-passed at 5 x `dynamics` (Hz), and notes on the pieces left out."""
    found, notes = stretches(logs, dynamics)
    return [_along(stretch, drive, 5 * dynamics) for stretch in found], notes


def _along(stretch: Stretch, drive: Drive, cutoff: float) -> MeasuredFriction:
    velocity, acceleration = differentiate(stretch.position, stretch.rate, cutoff)
    force = lowpass(stretch.force, stretch.rate, cutoff)
    friction = force + float(drive.plant.constant_force) - float(drive.plant.mass) * acceleration
    inner = slice(stretch.border, len(stretch.time) - stretch.border)
    return MeasuredFriction(
        log=stretch.log,
        rate=stretch.rate,
        time=stretch.time[inner],
        position=lowpass(stretch.position, stretch.rate, cutoff)[inner],
        velocity=velocity[inner],
        acceleration=acceleration[inner],
        friction=friction[inner],
        load=stretch.load[inner],
    )


def passes(along: MeasuredFriction) -> list[slice]:
    """The stretches between two zeros of the velocity, in order; a table at rest with noise makes many short ones."""
    forwards = along.velocity > 0
    edges = [0, *(np.flatnonzero(np.diff(forwards)) + 1).tolist(), len(forwards)]
    return [slice(a, b) for a, b in pairwise(edges)]


def load_groups(loads: Signal) -> Int[np.ndarray, " n"]:
    """The number of the load level of each sample: levels are 5 % of the largest load apart, or more."""
    order = np.argsort(loads)
    apart = np.diff(loads[order]) > 0.05 * np.max(np.abs(loads), initial=0.0)
    group = np.empty(len(loads), dtype=int)
    group[order] = np.concatenate([[0], np.cumsum(apart)])[: len(loads)]
    return group
