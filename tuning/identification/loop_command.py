"""The command of snapshots by the law of their loop: what it answers to the motion, without what it answers to noise.

A loop answers the noise of its encoder with noise in each command. A snapshot has that of its own instant; over the row
most of it cancels, since the velocity that is fed back is a difference. So noise that hardly moved the table stands in
the rows, as white as it is large, and no filter tells its slow part from a force. The law does: a cascade's command is
linear in error, its integral, velocities and accelerations of reference and position, whatever its gains, and these are
in the rows. Their coefficients are those of least squares, of the slow part of all signals, where the derivatives are
exact (`controller.signals.LOW_PASS`). All of ten thousand rows tell of nine coefficients: noise of 30 N in each leaves
0.6 N in all.

The integral of the loop collects the noise of its own samples, of which the rows are some: what it holds wanders about
what they say, as a random walk. That is tracked in the slow part of what the law leaves of the logged command (the
local level model: Harvey 1989, 2.3), as far as it is more likely than none.

What no cascade has in its command, a compensation of friction say, is followed likewise, and makes the level quick and
uncertain. What is left is white where the noise of a snapshot is that of its own instants. A velocity that is
differenced over whole rows leaves noise of successive rows that cancels, and has no slow part: it acts as logged.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline
from scipy.linalg import solveh_banded
from scipy.optimize import minimize_scalar
from scipy.signal import lfilter, oaconvolve

from diffdrive.logs import Log
from tuning.identification.controller.signals import LOW_PASS, SLOW, pieces

WHITE = 0.5  # of the slow part of white noise: half way to none
APART = SLOW + 1  # rows, from which on `LOW_PASS` of white noise is hardly correlated


class LoopCommand(NamedTuple):
    """The command of each log (N), and how well its slow part is known (N, standard deviation)."""

    commands: list[Float[np.ndarray, " n"]]
    std: float


def loop_command(logs: Sequence[Log]) -> LoopCommand | None:
    """The command of logs of one loop by its law; as logged where that acts, as it does where it is clipped.

    None without a reference in each log.
    """
    if any(log.reference is None for log in logs):
        return None
    found = [(k, piece) for k, log in enumerate(logs) for piece in pieces(log)]
    if not found:
        return None
    signals = [_signals(logs[k], piece) for k, piece in found]
    given = [logs[k].command[piece] for k, piece in found]
    constants = np.eye(len(found))  # of the integral, where each piece begins
    columns = [np.hstack([rows, np.tile(one, (len(rows), 1))]) for rows, one in zip(signals, constants, strict=True)]
    slow = np.concatenate([oaconvolve(one, LOW_PASS[:, None], "valid", axes=0) for one in columns])
    scale = np.linalg.norm(slow, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    asked = np.concatenate([np.convolve(one, LOW_PASS, "valid") for one in given])
    law, _, rank, _ = np.linalg.lstsq(slow / scale, asked)
    answers = [one / scale @ law for one in columns]
    left = [one - answer for one, answer in zip(given, answers, strict=True)]
    slow_left = [np.convolve(one, LOW_PASS, "valid")[::APART] for one in left]
    gain, variance = _wandering(slow_left)
    levels = [_in_rows(_level(one, gain), len(rest)) for one, rest in zip(slow_left, left, strict=True)]
    noise = np.concatenate([rest - level for rest, level in zip(left, levels, strict=True)])
    commands = [log.command.copy() for log in logs]
    if variance > WHITE * np.var(noise) * np.sum(LOW_PASS**2):
        for (k, piece), answer, level in zip(found, answers, levels, strict=True):
            commands[k][piece] = answer + level
    # of white noise, whose slow part has this variance, a share goes into each coefficient
    of_law = rank / len(noise) / np.sum(LOW_PASS**2)
    of_level = gain * (1.0 - gain) / (2.0 - gain)
    return LoopCommand(commands, float(np.sqrt(variance * (of_law + of_level))))


def _signals(log: Log, piece: slice) -> Float[np.ndarray, "n 7"]:
    """What a cascade computes its command from, in each row."""
    assert log.reference is not None
    time = (log.time - log.time[0])[piece]
    position, reference = (CubicSpline(time, one[piece] - log.position[0]) for one in (log.position, log.reference))
    error = CubicSpline(time, (log.reference - log.position)[piece])
    return np.stack(
        [
            error(time),
            error.antiderivative()(time),
            reference(time),
            reference(time, 1),
            reference(time, 2),
            position(time, 1),
            position(time, 2),
        ],
        axis=1,
    )


def _in_rows(level: Float[np.ndarray, " m"], count: int) -> Float[np.ndarray, " n"]:
    """A slow signal in each row; those at both ends have the nearest value."""
    return np.interp(np.arange(count), SLOW + APART * np.arange(len(level)), level)


def _wandering(left: Sequence[Float[np.ndarray, " n"]]) -> tuple[float, float]:
    """By how much of what is left its level follows at each step, and the variance (N^2) of what was not foreseen then.

    The level is a random walk beneath white noise: seen from the step before, exponential smoothing foresees it best
    (Muth 1960), and what it misses is white, so that the gain is likeliest that misses least.
    """
    count = sum(map(len, left))

    def missed(log_gain: float) -> float:
        gain = np.exp(log_gain)
        errors = (lfilter([1.0, -1.0], [1.0, gain - 1.0], one - np.mean(one)) for one in left)
        return sum(float(np.sum(error**2)) for error in errors)

    found = minimize_scalar(missed, bounds=(-np.log(count), 0.0), method="bounded")
    return float(np.exp(found.x)), float(found.fun) / count


def _level(left: Float[np.ndarray, " n"], gain: float) -> Float[np.ndarray, " n"]:
    """The level, from all steps before and after: a walk that costs (1 - gain) / gain^2 of what it misses."""
    step = (1.0 - gain) / gain**2
    bands = np.zeros((2, len(left)))
    bands[0, 1:] = -step
    bands[1] = 1.0 + 2.0 * step
    bands[1, [0, -1]] = 1.0 + step
    return solveh_banded(bands, left)
