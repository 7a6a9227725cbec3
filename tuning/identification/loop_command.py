"""The command of snapshots by the law of their loop: what it answers to the motion, without what it answers to noise.

A loop answers the noise of its encoder with noise in each command. A snapshot has that of its own instant; over the row
most of it cancels, since the velocity that is fed back is a difference. So noise that hardly moved the table stands in
the rows, as white as it is large, and no filter tells its slow part from a force. The law does: a cascade's command is
linear in error, its integral, velocities and accelerations of reference and position, whatever its gains, and these are
in the rows. Their coefficients are those of least squares, of the slow part of all signals, where the derivatives are
exact (`controller.signals.LOW_PASS`). Two logs of twelve thousand rows tell of nine coefficients: noise of 30 N in each
row leaves 0.6 N in all. Logs of other gains have laws of their own, where that is likelier by more than it takes in
coefficients (Akaike 1974).

The integral of the loop collects the noise of its own samples, of which the rows are some: what it holds wanders about
what they say, as a random walk. That is tracked in the slow part of what the law leaves of the logged command (the
local level model: Harvey 1989, 2.3). What no cascade has in its command, a compensation of friction say, is followed
likewise; the more it takes to follow it, the more of the noise is followed with it.

How large the noise of a snapshot is, successive rows show. It is white where it is that of the row's own instants. A
velocity that is differenced over whole rows leaves noise of successive rows that cancels: what the law leaves has no
slow part then, and the command acts as logged.
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
from tuning.identification.controller.signals import LOW_PASS, SLOW, pieces, row_noise

WHITE = 0.5  # of the slow part of white noise: half way to none
APART = SLOW + 1  # rows, from which on `LOW_PASS` of white noise is little correlated (0.17)
WHITE_SLOW = float(np.sum(LOW_PASS**2))  # of the variance of white noise, that its slow part has

Rows = Float[np.ndarray, "n k"]
Signal = Float[np.ndarray, " n"]


class LoopCommand(NamedTuple):
    """The command of each log (N), and how well its slow part is known: RMS (N) of its standard deviation over all rows
    that the law explains. The others are as logged.
    """

    commands: list[Signal]
    std: float


def loop_command(logs: Sequence[Log]) -> LoopCommand | None:
    """The command of logs by the law of their loop; as logged where that acts, as it does where it is clipped.

    None without a reference in each log.
    """
    if any(log.reference is None for log in logs):
        return None
    found = [(k, piece) for k, log in enumerate(logs) for piece in pieces(log)]
    if not found:
        return None
    signals, given = [_signals(logs[k], piece) for k, piece in found], [logs[k].command[piece] for k, piece in found]
    owner = np.array([k for k, _ in found])
    answers, coefficients = _likeliest_answers(signals, given, owner)
    slow_left = [_slow(one - answer)[::APART] for one, answer in zip(given, answers, strict=True)]
    noise, commands = row_noise(given), [log.command.copy() for log in logs]
    unforeseen = _wandering(slow_left)[1]
    if unforeseen <= WHITE * noise**2 * WHITE_SLOW:
        return LoopCommand(commands, float(np.sqrt(unforeseen)))
    white = noise**2 * WHITE_SLOW
    gain = _wandering(slow_left, white)[0]
    for (k, piece), answer, rest in zip(found, answers, slow_left, strict=True):
        commands[k][piece] = answer + _in_rows(_level(rest, gain), len(answer))
    # of white noise a share goes into each coefficient, and one into the level (its smoothed variance)
    of_law, of_level = noise**2 * coefficients / sum(map(len, given)), white * gain / (2.0 - gain)
    return LoopCommand(commands, float(np.sqrt(of_law + of_level)))


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


def _likeliest_answers(
    signals: Sequence[Rows], given: Sequence[Signal], owner: Float[np.ndarray, " p"]
) -> tuple[list[Signal], int]:
    """What the law makes of each piece, one law for all logs or one for each, and of how many coefficients."""
    together = _answers(signals, given)
    if len(set(owner)) == 1:
        return together[0], together[1]
    answers, coefficients, squares = list[Signal](), 0, 0.0
    for log in dict.fromkeys(owner):
        own = [k for k, one in enumerate(owner) if one == log]
        part = _answers([signals[k] for k in own], [given[k] for k in own])
        answers, coefficients, squares = answers + part[0], coefficients + part[1], squares + part[2]
    count = sum(map(len, given)) / APART  # that are independent of what is slow
    if together[2] == 0.0 or count * np.log(together[2] / max(squares, 1e-300)) <= 2.0 * (coefficients - together[1]):
        return together[0], together[1]
    return answers, coefficients


def _answers(signals: Sequence[Rows], given: Sequence[Signal]) -> tuple[list[Signal], int, float]:
    """What one law makes of each piece, its coefficients, and the squares that it leaves of the slow part."""
    constants = np.eye(len(given))  # of the integral, where each piece begins
    columns = [np.hstack([rows, np.tile(one, (len(rows), 1))]) for rows, one in zip(signals, constants, strict=True)]
    slow = np.concatenate([oaconvolve(one, LOW_PASS[:, None], "valid", axes=0) for one in columns])
    asked = np.concatenate([_slow(one) for one in given])
    scale = np.linalg.norm(slow, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    law, _, rank, _ = np.linalg.lstsq(slow / scale, asked)
    return [one / scale @ law for one in columns], int(rank), float(np.sum((asked - slow / scale @ law) ** 2))


def _slow(signal: Signal) -> Signal:
    return np.convolve(signal, LOW_PASS, "valid")


def _in_rows(level: Float[np.ndarray, " m"], count: int) -> Signal:
    """A slow signal in each row; those at both ends have the nearest value."""
    return np.interp(np.arange(count), SLOW + APART * np.arange(len(level)), level)


def _wandering(left: Sequence[Signal], white: float | None = None) -> tuple[float, float]:
    """By how much of what is left its level follows at each step, and the variance (N^2) of what was not foreseen then.

    The level is a random walk beneath white noise, of the variance `white` (N^2) if that is known: seen from the step
    before, exponential smoothing foresees it best (Muth 1960), and misses white / (1 - gain).
    """
    count = sum(map(len, left))

    def missed(gain: float) -> float:
        errors = (lfilter([1.0, -1.0], [1.0, gain - 1.0], one - np.mean(one)) for one in left)
        return sum(float(np.sum(error**2)) for error in errors)

    def unlikely(log_gain: float) -> float:
        gain = float(np.exp(log_gain))
        if not white:
            return missed(gain)
        variance = white / max(1.0 - gain, 1e-12)
        return count * float(np.log(variance)) + missed(gain) / variance

    found = minimize_scalar(unlikely, bounds=(-np.log(count), 0.0), method="bounded")
    gain = float(np.exp(found.x))
    return gain, missed(gain) / count


def _level(left: Signal, gain: float) -> Signal:
    """The level, from all steps before and after: a walk that costs (1 - gain) / gain^2 of what it misses."""
    step = (1.0 - gain) / gain**2
    bands = np.zeros((2, len(left)))
    bands[0, 1:] = -step
    bands[1] = 1.0 + 2.0 * step
    bands[1, [0, -1]] = 1.0 + step
    return solveh_banded(bands, left)
