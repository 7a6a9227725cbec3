"""Backlash and wind-up, separated by the force in reversals: a gap is crossed without force, a screw winds up under it.

The screw's force S is a function of what motor and table are apart, whatever came before: S = k dz(d), where dz is d
outside a gap g and zero within. The motor's balance through a reversal is therefore

    u = c + F_m b(q) + m (a + t da/dt) + D v + k (dz(d) + t d/dt dz(d)) ,

with its own friction F_m b, which turns over a travel l after the motor does, its inertia m a, its damping D v, and a
time t between the force and the encoders. For each g and l on a grid the rest is linear. Whole reversals are drawn
with replacement for the interval of g.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.stats import f as fisher

from diffdrive.logs.checks.statistics import derivative, robust_std
from diffdrive.logs.encoders.passes import Passes
from diffdrive.logs.encoders.regression import LEVEL, Estimate

FEWEST = 6  # reversals: that so many err to one side is less likely than 5 %
# What the model leaves is alike in all reversals and does not average out: of simulated machines as many intervals
# hold the true gap as should if no more reversals than these count for the misfit.
_INDEPENDENT = 12
_DRAWS = 200
_SPAN = 4.0  # reversal errors of motor travel to either side of a reversal
_LEAST = 12  # samples to either side
_MOST = 400  # samples of one reversal that are needed
_GAPS = np.linspace(0.0, 1.0, 41)  # of the reversal error
_SLIPS = np.array([0.1, 0.2, 0.4, 0.8, 1.6])
_FRICTIONS = 2 * len(_SLIPS) + 1  # exponential (Dahl), elastic up to sliding, and at once
# Rotary inertia of motor and screw makes up to nine tenths of a feed axis's moving mass: that of a short-lead screw
# under a light table.
LEAST_TABLE_SHARE = 0.1


class Signals(NamedTuple):
    """What a reversal is seen by, at each sample of the passes."""

    deflection: Float[np.ndarray, " n"]  # m, motor minus table without the errors of screw and scale
    motor: Float[np.ndarray, " n"]  # m
    command: Float[np.ndarray, " n"]  # N
    period: float  # s


class _Motion(NamedTuple):
    """Of the motor."""

    velocity: Float[np.ndarray, " n"]  # m/s
    acceleration: Float[np.ndarray, " n"]  # m/s^2
    jerk: Float[np.ndarray, " n"]  # m/s^3
    moving: Bool[np.ndarray, " n"]  # beyond its noise: at rest its friction is anything


def _window(signals: Signals, passes: Passes, turn: int, reversal_error: float) -> tuple[Int[np.ndarray, " m"], int]:
    """Samples of one reversal, and where the motor turned."""
    before = int(np.searchsorted(passes.number, passes.number[turn - 1]))
    after = int(np.searchsorted(passes.number, passes.number[turn], "right"))
    side = passes.direction[turn]
    # where the motor turned: the extreme of either neighbourhood, for it runs ahead of the table
    middle = slice((before + turn) // 2, (turn + after) // 2)
    extreme = middle.start + int(np.argmin(side * signals.motor[middle]))
    travel = np.abs(signals.motor[before:after] - signals.motor[extreme])
    near = np.flatnonzero(travel < _SPAN * reversal_error) + before
    first = min(int(near[0]) if near.size else extreme, extreme - _LEAST)
    last = max(int(near[-1]) if near.size else extreme, extreme + _LEAST)
    return np.arange(max(first, before), min(last + 1, after)), extreme


def _moments(
    signals: Signals, rows: Int[np.ndarray, " m"], extreme: int, side: float, motion: _Motion, reversal_error: float
) -> Float[np.ndarray, "gaps slips p p"] | None:
    """Sums of products of all columns, the command last, over one reversal into direction `side`."""
    moving = np.flatnonzero(motion.moving[rows])
    if len(moving) < _LEAST:
        return None
    travel = np.abs(signals.motor[rows] - signals.motor[extreme])
    d = signals.deflection[rows]
    half = 0.5 * reversal_error * _GAPS[:, None]
    beyond = d - np.clip(d, -half, half)
    rate = np.gradient(beyond, signals.period, axis=1)
    share = travel / (_SLIPS[:, None] * reversal_error)
    turned = np.concatenate([1.0 - 2.0 * np.exp(-share), np.minimum(1.0, share - 1.0), np.ones((1, len(travel)))])
    friction = side * np.where(rows < extreme, -1.0, turned)
    kept = moving[:: 1 + len(moving) // _MOST]
    rows, columns = rows[kept], np.empty((len(_GAPS), _FRICTIONS, 8, len(kept)))
    columns[:, :, 0], columns[:, :, 1] = 1.0, friction[:, kept]
    columns[:, :, 2], columns[:, :, 3] = motion.acceleration[rows], motion.velocity[rows]
    columns[:, :, 4], columns[:, :, 5] = beyond[:, None, kept], rate[:, None, kept]
    columns[:, :, 6], columns[:, :, 7] = motion.jerk[rows], signals.command[rows]
    return columns @ np.swapaxes(columns, -1, -2)


def _squares(moments: Float[np.ndarray, "draws gaps slips p p"]) -> Float[np.ndarray, "draws gaps"]:
    """Least squares of each draw at each gap; infinite where the screw or its friction would be negative."""
    scale = np.sqrt(np.maximum(np.einsum("...ii->...i", moments), 1e-300))
    scaled = moments / (scale[..., :, None] * scale[..., None, :])
    a, b, yy = scaled[..., :-1, :-1], scaled[..., :-1, -1], scaled[..., -1, -1]
    # a gap as wide as the reversal error leaves nothing of the deflection
    solution = np.linalg.solve(a + 1e-9 * np.eye(a.shape[-1]), b[..., None])[..., 0]
    squares = (yy - np.einsum("...i,...i->...", solution, b)) * scale[..., -1] ** 2
    return np.min(np.where((solution[..., 4] >= 0.0) & (solution[..., 1] >= 0.0), squares, np.inf), axis=-1)


def backlash_of_reversals(signals: Signals, passes: Passes, reversal_error: float) -> Estimate | None:
    """The gap (m) that the force in the reversals shows; None from fewer than `FEWEST` of them."""
    if len(passes.turns) < FEWEST or reversal_error <= 0.0:
        return None
    velocity, acceleration, jerk = (derivative(signals.motor, signals.period, order, 0.0) for order in (1, 2, 3))
    noise = robust_std(np.diff(signals.motor, 3)) / np.sqrt(20.0)
    motion = _Motion(velocity, acceleration, jerk, np.abs(velocity) > 3.0 * noise / signals.period)
    found = []
    for turn in passes.turns.tolist():
        rows, extreme = _window(signals, passes, turn, reversal_error)
        sums = _moments(signals, rows, extreme, float(passes.direction[turn]), motion, reversal_error)
        if sums is not None:
            found.append(sums)
    if len(found) < FEWEST:
        return None
    each = np.stack(found)
    rng = np.random.default_rng(0)
    weights = rng.multinomial(len(each), np.full(len(each), 1.0 / len(each)), _DRAWS).astype(float)
    weights = np.concatenate([np.ones((1, len(each))), weights])
    drawn = (weights @ each.reshape(len(each), -1)).reshape(-1, *each.shape[1:])
    squares = _squares(drawn)
    if not np.isfinite(squares[0]).any():
        return None
    best = np.argmin(squares, axis=1)
    tail = 0.5 * (1.0 - LEVEL)
    low, high = np.quantile(_GAPS[best[1:]], [tail, 1.0 - tail])
    count = min(len(each), _INDEPENDENT)
    allowed = squares[0, best[0]] * (1.0 + float(fisher.ppf(LEVEL, 1, count)) / count)
    within = _GAPS[squares[0] <= allowed]
    value, step = float(_GAPS[best[0]]), float(_GAPS[1])
    low = max(0.0, min(float(low), float(within[0])) - 0.5 * step)
    high = min(1.0, max(float(high), float(within[-1])) + 0.5 * step)
    return Estimate(value, low, high).times(reversal_error)
