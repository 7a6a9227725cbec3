"""How the rows of a log are to be read: every sample of the controller, or snapshots of a faster loop."""

from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs import Log
from tuning.identification.controller.fit import Candidate, LawFit, search_law, with_covariance
from tuning.identification.controller.law import Reading
from tuning.identification.controller.moments import left_free
from tuning.identification.controller.search import LATE
from tuning.identification.controller.signals import (
    AROUND,
    DIFFERENCES,
    Equation,
    every_sample,
    pieces,
    position_noise,
    snapshots,
)

SAMPLES = range(1, 9)  # over which a velocity is differenced
DELAYS = range(-1, 4)  # rows from computing a command to logging it
SNAPSHOT_DELAYS = (-1, 0, 1)
CONVINCED = 15.1  # of chi squared with one degree of freedom: a chance of 1e-4 that noise alone shows so much
LAG = 5  # of the regressors of every sample: how reference and measured velocity differ, whose coefficient is the gain
SAME = 5.0  # standard deviations
TRIED_ROWS = 8_000  # of a log, from which its reading is chosen: noise of so many rows is known to a hundredth


def fit_log(log: Log) -> LawFit:
    """The law of one log, as its rows are to be read.

    Raises `LogError` where the log has no reference, no stretch that can be used, or no cascade's command.
    """
    if log.reference is None:
        raise LogError(f"{log.name}: reference: is missing; a controller is found from reference, position and command")
    found = list(pieces(log))
    if not found:
        raise LogError(
            f"{log.name}: has no stretch that is long enough, without a gap and without a clipped command; log a "
            "longer motion"
        )
    reading = _reading(log, _busiest(log, found))
    law = search_law([reading.equation(log, piece) for piece in found], 1.0 / log.rate, reading.reading)
    if law is None:
        raise LogError(
            f"{log.name}: command: does not push against the following error; check the signs of command and position, "
            "and that the reference is that of this axis"
        )
    return with_covariance(law, reading.samples)


class _Choice(NamedTuple):
    """A way to read a log; `samples` are those of the velocity, where each row is one."""

    reading: Reading
    equation: Callable[[Log, slice], Equation]
    samples: int | None = None

    def search(self, log: Log, part: slice) -> Candidate | None:
        """What it makes of a part of the log, the fed-forward speed being that of the row."""
        return search_law([self.equation(log, part)], 1.0 / log.rate, self.reading, held=((LATE,),))


def _reading(log: Log, part: slice) -> _Choice:
    """Every sample where that explains the noise of the command, and better than snapshots do."""
    snapshots, every = _snapshots(log, part), _every_sample(log, part)
    if every is None:
        return snapshots
    choice, found = every
    other = snapshots.search(log, part)
    return choice if other is None or found.residual <= other.residual else snapshots


def _busiest(log: Log, found: list[slice]) -> slice:
    """`TRIED_ROWS` in a row, those with the longest way."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(log.position)))])

    def parts() -> Iterator[tuple[float, slice]]:
        for piece in found:
            for start in range(piece.start, max(piece.stop - TRIED_ROWS, piece.start) + 1, TRIED_ROWS // 4):
                stop = min(start + TRIED_ROWS, piece.stop)
                yield float(way[stop - 1] - way[start]), slice(start, stop)

    return max(parts(), key=lambda part: part[0])[1]


def _every_sample(log: Log, part: slice) -> tuple[_Choice, Candidate] | None:
    """With the samples and the delay that leave least; the law also says how r' and r'' are taken.

    None where the noise of the position is left. Of snapshots the older sample of each velocity is not in the log, so
    that its noise is, gain times noise over time. Of every sample only rounding is: half of that variance is between.
    """
    noise = position_noise(log, [part]) * log.rate
    found: list[tuple[_Choice, Candidate]] = []
    for samples, delay, gain, left in _least_left(log, part):
        if left > np.sqrt(0.5) * abs(gain) * noise / samples:
            continue
        for differences in DIFFERENCES:
            equation = partial(every_sample, samples=samples, delay=delay, differences=differences)
            choice = _Choice(Reading.EVERY_SAMPLE, equation, samples)
            candidate = choice.search(log, part)
            if candidate is not None and candidate.residual < np.sqrt(0.5) * candidate.gain * noise / samples:
                found.append((choice, candidate))
    return min(found, key=lambda one: one[1].residual, default=None)


def _least_left(log: Log, part: slice) -> list[tuple[int, int, float, float]]:
    """Samples, delay, gain and what is left of those that leave least before any law binds.

    Several may leave the same: with coefficients that are free, the integral of a velocity over two samples has the
    position between. What differs by less than the scatter of a root mean square of so many rows is the same, and so is
    what is no more than the velocity's rounding makes: of a log without noise nothing else is left.
    """
    longest, (first, last) = SAMPLES[-1], (DELAYS[0], DELAYS[-1])
    rows = slice(part.start - first + longest, part.stop - last - AROUND)
    commands = np.stack([log.command[rows.start + delay : rows.stop + delay] for delay in DELAYS], axis=1)
    commands = commands - commands.mean(axis=0)
    tried: list[tuple[int, int, float, float]] = []
    for samples in SAMPLES:
        columns = every_sample(log, part, samples, 0).regressors
        begin = rows.start - part.start - max(samples, AROUND)  # of the columns, which begin that late in the part
        columns = columns[begin : begin + len(commands)]
        columns = columns - columns.mean(axis=0)
        left = left_free(columns, commands)
        gains = np.linalg.lstsq(columns, commands)[0][LAG]
        tried += [(samples, delay, *pair) for delay, *pair in zip(DELAYS, gains.tolist(), left.tolist(), strict=True)]
    least = min(left for *_, left in tried) * (1.0 + SAME / np.sqrt(2.0 * len(commands)))
    rounding = float(np.finfo(float).eps * np.max(np.abs(log.position[part]))) * log.rate
    return [one for one in tried if one[-1] <= max(least, rounding * abs(one[2]) / one[0])]


def _snapshots(log: Log, part: slice) -> _Choice:
    """The command of the position beside it only where its noise shows that: otherwise it has an instant of its own."""
    noise = position_noise(log, [part])
    read = {delay: partial(snapshots, delay=delay, noise=noise) for delay in SNAPSHOT_DELAYS}
    shown = {delay: _moves_with_noise(equation(log, part)) for delay, equation in read.items()}
    delay = max(shown, key=lambda delay: shown[delay])
    if shown[delay] > CONVINCED:
        return _Choice(Reading.SAME_INSTANT, read[delay])
    return _Choice(Reading.OWN_INSTANT, read[0])


def _moves_with_noise(equation: Equation) -> float:
    """Chi squared of the command moving with the noise of the position beside it, against it, as feedback does.

    Zero where it moves the other way. What the condition of motion fits badly is no doubt of this one: it is of what
    motion leaves.
    """
    motion, quiet = equation.conditions
    theta = np.linalg.lstsq(motion.regressors[:, :-1], motion.commands[:, motion.commands.shape[1] // 2])[0]
    rows = quiet.instruments[:, 0] != 0
    if not rows.any():
        return 0.0
    own, noise = quiet.instruments[rows, 0], quiet.regressors[rows, -1]
    left = quiet.commands[rows, quiet.commands.shape[1] // 2] - quiet.regressors[rows, :-1] @ theta
    moved = own @ left / (own @ noise)
    variance = np.mean((left - moved * noise) ** 2) * (own @ own) / (own @ noise) ** 2
    return float(moved**2 / variance) if moved < 0 else 0.0
