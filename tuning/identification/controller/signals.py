"""The signals that a cascade computes its command from, as far as the rows of a log show them.

Two readings of a log. In `every_sample` each row is one period of the controller: its arithmetic is reproduced, noise
of the position included, and nothing is left but the rounding of the command. In `snapshots` the rows are picked from a
faster loop: the velocity between them is a derivative, of which the fast part is wrong twice, by the noise of the rows
and by motion that is faster than they are. So motion and noise are two conditions. That of motion is asked of the slow
part of all signals, and what the noise adds to its sums is taken away (Söderström 2018, bias compensation). That of
noise says how the command moves with the position of its own row, from which the velocity's window follows.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from diffdrive.logs import Log

# e, its integral, r', r, r'', and how reference and measured velocity differ: e' (and its integral) or e', e'', y'''
Rows = Float[np.ndarray, "n k"]

STENCIL = np.arange(-2, 3)  # rows of a regressor: a quartic through five is exact to the jerk's derivative
# rows that tell motion from noise: none of those from which the noise of the row is taken
OUTER = np.array([-9, -8, -7, -6, -5, -4, 4, 5, 6, 7, 8, 9])
OUTER_DEGREE = 5  # of the polynomial through them
SLOW = 4  # rows on either side
# Half of what has a period of ten rows passes, nothing of what has five or less: a quartic's derivatives are exact to
# (2 pi / 10)^4 / 30, half a per cent, there, and what rows fold down from above their own rate is faster by nine times
LOW_PASS = np.hanning(2 * SLOW + 3)[1:-1] / np.sum(np.hanning(2 * SLOW + 3))
# the row minus the quintic through its six neighbours: it leaves (2 pi / 10)^6 / 20 of motion at ten rows a period
NOISE = np.array([-1.0, 6.0, -15.0, 20.0, -15.0, 6.0, -1.0]) / 20.0
NORMAL_MEDIAN = 0.6745  # of the magnitude of a standard normal number
CALM = 16  # rows on either side
SAMPLES_TO_A_ROW = 16  # of the controller, at most
MARGIN = 9  # rows at each end of a piece that have not all of `OUTER`
MIN_ROWS = 64  # a piece with fewer rows than four times both margins shows less than it costs: a constant of its own
HELD_ROWS = 3  # a command that stands at its extreme for so long is clipped: noise moves an unclipped one


class Condition(NamedTuple):
    """Instruments that are orthogonal to the command less regressors times coefficients, summed over the rows.

    `excess` is what the noise of the position takes from the sums of instruments with regressors, for each row;
    `level` multiplies the root mean square of what is left to that of its slow part, which the instruments see.
    """

    instruments: Rows
    regressors: Rows
    commands: Rows
    excess: Float[np.ndarray, "q k"] | float = 0.0
    level: float = 1.0


class Equation(NamedTuple):
    """command = regressors times coefficients, at each row of a piece, in deviations from the piece's mean.

    `commands` are the command at neighbouring rows, from which it is interpolated to the instant of the others. Its
    coefficients follow from the `conditions`.
    """

    regressors: Rows
    commands: Rows
    conditions: tuple[Condition, ...]


def pieces(log: Log) -> Iterator[slice]:
    """The stretches of a log without a gap and without a clipped command, after which the integral is unknown."""
    clipped = _clipped(log.command)
    for piece in log.pieces():
        edges = np.flatnonzero(np.diff(np.concatenate([[1], clipped[piece].astype(int), [1]])))
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if stop - start >= MIN_ROWS:
                yield slice(piece.start + int(start), piece.start + int(stop))


def _clipped(command: Float[np.ndarray, " n"]) -> np.ndarray:
    """The rows at which the command stands at its highest or lowest value."""
    clipped = np.zeros(len(command), bool)
    for extreme in (np.max(command), np.min(command)):
        at = command == extreme
        held = np.convolve(at, np.ones(HELD_ROWS), "valid") == HELD_ROWS
        if held.any():
            clipped |= at
    return clipped


class Differences(NamedTuple):
    """How velocity and acceleration of the reference are taken: weights of two rows before to two rows after."""

    speed: tuple[float, ...]
    acceleration: tuple[float, ...]


BACKWARD, CENTRAL = (0.0, -1.0, 1.0, 0.0, 0.0), (0.0, -0.5, 0.0, 0.5, 0.0)
COMPACT = (0.0, 1.0, -2.0, 1.0, 0.0)
DIFFERENCES = (
    Differences(CENTRAL, COMPACT),  # nearest to an analytic profile
    Differences(CENTRAL, (0.25, 0.0, -0.5, 0.0, 0.25)),  # each once more of the one before
    Differences(BACKWARD, (1.0, -2.0, 1.0, 0.0, 0.0)),
    Differences(BACKWARD, COMPACT),
)
AROUND = 2  # rows that these take on either side


def every_sample(
    log: Log, piece: slice, samples: int, delay: int, differences: Differences = DIFFERENCES[0]
) -> Equation:
    """Each row as one period: velocity over `samples` rows, the command logged `delay` rows after its own."""
    period = 1.0 / log.rate
    r, y = log.reference[piece], log.position[piece]  # type: ignore[index]  # asked for before
    n = np.arange(max(samples, AROUND), len(r) - max(delay, 0) - AROUND)
    n = n[n + delay >= 0]
    error = r - y
    near = (r - r[0])[n[:, None] + np.arange(-AROUND, AROUND + 1)]
    speed = near @ np.array(differences.speed) / period
    lag = speed - (y[n] - y[n - samples]) / (samples * period)
    columns = np.stack(
        [
            error[n],
            integral(error[n], period),
            speed,
            integral(speed, period),
            near @ np.array(differences.acceleration) / period**2,
            lag,
            integral(lag, period),
        ],
        axis=1,
    )
    columns, command = _centred(columns), _centred(log.command[piece][n + delay][:, None])
    return Equation(columns, command, (Condition(columns, columns, command),))


def snapshots(log: Log, piece: slice, delay: int, noise: float) -> Equation:
    """Rows picked from a faster loop, with a position of this noise (m), the command `delay` rows after its own row.

    The last regressor is the noise of the row itself, as far as its neighbours tell it from motion; the others are
    without it. Where the command of a row is computed from the position in that row, this noise is in the command.
    """
    period = 1.0 / log.rate
    r, y, u = (signal[piece] for signal in (log.reference, log.position, log.command))  # type: ignore[index]
    inner = slice(MARGIN, len(r) - MARGIN)
    summed = _smooth_integral(r - y, period)[inner]
    near = _columns(_derivatives(r, STENCIL, 4, period), _derivatives(y, STENCIL, 4, period), summed)
    commands = u[np.arange(MARGIN, len(r) - MARGIN)[:, None] + STENCIL + delay]
    taps = _noise_taps(period)
    reach = len(NOISE) // 2
    own = np.convolve(y - y[0], NOISE, "valid")[MARGIN - reach : len(r) - MARGIN - reach]
    clean = np.column_stack([near - own[:, None] * taps[len(STENCIL) // 2], own])
    smooth = _derivatives(y, OUTER, OUTER_DEGREE, period)
    moving = period * np.abs(smooth[1]) > SAMPLES_TO_A_ROW * _quantum(y)
    quiet = _where_calm(y[inner] - smooth[0], moving)[:, None]
    clean, quiet, now = (part[SLOW:-SLOW] for part in (clean, quiet, commands))
    looked = quiet != 0
    quiet = quiet - looked * np.sum(quiet) / max(1, np.count_nonzero(looked))
    clean, now = _centred(clean), _centred(now)
    slow = _centred(_slow(near))
    slow_taps = np.stack([np.convolve(tap, LOW_PASS) for tap in taps.T], axis=1)
    own_tap = np.convolve(np.arange(len(STENCIL)) == len(STENCIL) // 2, LOW_PASS)
    return Equation(
        clean,
        now,
        (
            Condition(
                slow,
                np.column_stack([slow, np.zeros(len(slow))]),
                _centred(_slow(commands)),
                noise**2 * slow_taps.T @ np.column_stack([-slow_taps, own_tap]),
                level=float(1.0 / np.linalg.norm(LOW_PASS)),
            ),
            Condition(quiet, clean, now),
        ),
    )


def _noise_taps(period: float) -> Float[np.ndarray, "5 k"]:
    """How the regressors of motion move with the position in each row of the stencil; an integral hardly does."""
    value, first, second, third = _weights(STENCIL, 4, period)
    none = np.zeros(len(STENCIL))
    return np.stack([-value, none, none, none, none, -first, -second, third], axis=1)


def _slow(columns: Rows) -> Rows:
    return np.stack([np.convolve(column, LOW_PASS, "valid") for column in columns.T], axis=1)


def _columns(r: list[np.ndarray], y: list[np.ndarray], summed_error: np.ndarray) -> Rows:
    return np.stack([r[0] - y[0], summed_error, r[1], r[0], r[2], r[1] - y[1], r[2] - y[2], y[3]], axis=1)


def _derivatives(signal: np.ndarray, rows: np.ndarray, degree: int, period: float) -> list[np.ndarray]:
    """Value and three derivatives of the polynomial of this degree through neighbouring rows, within the margins."""
    offset = signal[0]  # positions far from zero would cost digits
    windows = np.lib.stride_tricks.sliding_window_view(signal - offset, 2 * MARGIN + 1)[:, rows + MARGIN]
    found = windows @ _weights(rows, degree, period).T
    found[:, 0] += offset
    return list(found.T)


def _weights(rows: np.ndarray, degree: int, period: float) -> np.ndarray:
    """Weights of the rows for value and three derivatives of the polynomial through them, [4, rows]."""
    scale = float(np.max(np.abs(rows)))
    fit = np.linalg.pinv(np.vander(rows / scale, degree + 1, increasing=True))
    return fit[:4] * (np.array([1.0, 1.0, 2.0, 6.0]) / (scale * period) ** np.arange(4))[:, None]


def integral(signal: Float[np.ndarray, " n"], period: float) -> Float[np.ndarray, " n"]:
    """The integral by trapezoids, from the first row on."""
    return period * np.concatenate([[0.0], np.cumsum(0.5 * (signal[1:] + signal[:-1]))])


def position_noise(log: Log, found: Sequence[slice]) -> float:
    """Standard deviation of the noise of a position (m)."""
    return row_noise([log.position[piece] for piece in found])


def row_noise(stretches: Sequence[Float[np.ndarray, " n"]]) -> float:
    """Standard deviation of what differs from row to row of a signal, by the median, which motion hardly moves."""
    left = np.concatenate([np.convolve(one, NOISE, "valid") for one in stretches])
    return float(np.median(np.abs(left)) / NORMAL_MEDIAN / np.linalg.norm(NOISE))


def _where_calm(noise: Float[np.ndarray, " n"], moving: Bool[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """The noise where the motion is slow enough to leave it alone, zero elsewhere.

    Reversals and vibrations are in it, too, up to a hundred times larger. The root mean square over 33 rows of white
    noise scatters by an eighth: the calmest quarter lies two thirds of that below its mean, and three of it above the
    mean are 1.5 times as much. Of an axis that stands, the rounding of
    successive samples is one and the same, and shows no window of a velocity: it must move by a count to a sample.
    """
    if not moving.any():
        return np.zeros(len(noise))
    local = np.sqrt(np.convolve(noise**2, np.ones(2 * CALM + 1) / (2 * CALM + 1), "same"))
    return np.where(moving & (local <= 1.5 * np.quantile(local[moving], 0.25)), noise, 0.0)


def _quantum(position: Float[np.ndarray, " n"]) -> float:
    """The count of an encoder (m): the smallest step of the position beyond rounding."""
    steps = np.abs(np.diff(position))
    steps = steps[steps > 16.0 * np.finfo(float).eps * np.max(np.abs(position))]
    return float(np.min(steps)) if len(steps) else 0.0


def _smooth_integral(signal: Float[np.ndarray, " n"], period: float) -> Float[np.ndarray, " n"]:
    """The integral of the cubics through four rows each; by trapezoids at both ends, which are left out."""
    steps = 0.5 * (signal[1:] + signal[:-1])
    steps[1:-1] = np.convolve(signal, np.array([-1.0, 13.0, 13.0, -1.0]) / 24.0, "valid")
    return period * np.concatenate([[0.0], np.cumsum(steps)])


def _centred(columns: Rows) -> Rows:
    return columns - columns.mean(axis=0)


QUARTIC = np.linalg.inv(np.vander(STENCIL, increasing=True)).T


def interpolation(shift: complex | np.ndarray) -> np.ndarray:
    """Weights of the rows of `STENCIL` for the value `shift` rows after the middle one: the quartic through them.

    [5]; of shifts [m], [5, m].
    """
    return QUARTIC @ np.power.outer(shift, np.arange(len(STENCIL))).T
