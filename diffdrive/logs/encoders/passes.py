"""The passes of a log: stretches in one direction, where on them the table slides, and the reversals between them."""

import itertools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from diffdrive.logs.checks.grid import noise_std
from diffdrive.logs.checks.statistics import SMOOTHING, derivative, window_length
from diffdrive.logs.log import Log

# Below a tenth of a pass's top speed friction is no longer Coulomb's alone; on the first tenth of its travel the
# bristles and the screw are still being wound up.
SLOW, SETTLING = 0.1, 0.1
# Travel back by less than this share of the log's is an overshoot or a standstill, no pass.
SHORTEST = 0.01
NOISE_PEAKS = 10.0  # standard deviations between the peaks of noise to either side


class Passes(NamedTuple):
    """Samples of a log by pass; the pieces between gaps come one after another, short ones left out."""

    rows: Int[np.ndarray, " n"]  # index into the log
    number: Int[np.ndarray, " n"]  # of the pass
    direction: Float[np.ndarray, " n"]  # +1, -1
    sliding: Bool[np.ndarray, " n"]  # the table slides, the screw is wound up
    velocity: Float[np.ndarray, " n"]  # m/s, of the motor
    acceleration: Float[np.ndarray, " n"]  # m/s^2, of the motor
    jerk: Float[np.ndarray, " n"]  # m/s^3, of the motor
    turns: Int[np.ndarray, " reversals"]  # sample at which a pass begins that follows another without a gap


def _turning_points(position: Float[np.ndarray, " n"], least: float) -> list[int]:
    """Samples of the extremes between which the position travels by more than `least` (m)."""
    steps = np.sign(np.diff(position))
    moving = np.flatnonzero(steps)
    if not moving.size:
        return []
    changes = moving[1:][np.diff(steps[moving]) != 0]
    candidates = [*changes.tolist(), len(position) - 1]
    turns: list[int] = []
    low = high = 0
    side = 0
    values = position[candidates]
    for k, value in zip(candidates, values.tolist(), strict=True):
        if side >= 0 and value > position[high]:
            high = k
        if side <= 0 and value < position[low]:
            low = k
        if side >= 0 and position[high] - value > least:
            if side > 0:
                turns.append(high)
            side, low = -1, k
        elif side <= 0 and value - position[low] > least:
            if side < 0:
                turns.append(low)
            side, high = 1, k
        if side == 0 and position[high] - position[low] > least:
            side = 1 if high > low else -1
    return turns


def find_passes(log: Log, period: float) -> Passes | None:
    """The passes of a log with two encoders; None where the table hardly moves."""
    assert log.motor_position is not None
    least = max(SHORTEST * float(np.ptp(log.position)), NOISE_PEAKS * noise_std(log.position))
    window = window_length(1.0 / period, SMOOTHING)
    parts: list[list[np.ndarray]] = []
    turns: list[int] = []
    passes = count = 0
    for piece in log.pieces():
        table, motor = log.position[piece], log.motor_position[piece]
        if len(table) < 2 * window or np.ptp(table) <= least:
            continue
        velocity, acceleration, jerk = (derivative(motor, period, order) for order in (1, 2, 3))
        ends = [0, *_turning_points(table, least), len(table)]
        number, direction = np.empty(len(table), dtype=int), np.empty(len(table))
        sliding = np.zeros(len(table), dtype=bool)
        for start, stop in itertools.pairwise(ends):
            travel = table[stop - 1] - table[start]
            side = 1.0 if travel > 0 else -1.0
            speed = side * velocity[start:stop]
            number[start:stop], direction[start:stop] = passes, side
            done = side * (table[start:stop] - table[start])
            wound_up = (done > SETTLING * abs(travel)) & (abs(travel) > least)
            sliding[start:stop] = wound_up & (speed > SLOW * np.max(speed))
            passes += 1
        turns += [count + turn for turn in ends[1:-1]]
        count += len(table)
        rows = np.arange(piece.start, piece.stop)
        parts.append([rows, number, direction, sliding, velocity, acceleration, jerk])
    if not parts:
        return None
    rows, number, direction, sliding, velocity, acceleration, jerk = (
        np.concatenate(one) for one in zip(*parts, strict=True)
    )
    return Passes(rows, number, direction, sliding, velocity, acceleration, jerk, np.array(turns, dtype=int))


def pushed(passes: Passes, command: Float[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Where the screw pushes the table the way that it slides: strong braking puts it onto the backlash's other side.

    The screw's force is zero where deceleration takes all of the table's friction, the command where it takes all of
    the friction. Half of the friction's command leaves a factor of two for where mass and friction sit.
    """
    sliding = passes.sliding
    sides = [sliding & (passes.direction == side) for side in (1.0, -1.0)]
    if not all(side.any() for side in sides):
        return sliding
    forward, backward = (float(np.median(command[side])) for side in sides)
    middle, friction = 0.5 * (forward + backward), 0.5 * (forward - backward)
    return sliding & (passes.direction * np.sign(friction) * (command - middle) > 0.5 * abs(friction))
