"""How the rows of a log are to be read: every sample of the controller, or snapshots of a faster loop."""

import itertools
from collections.abc import Callable, Iterator
from functools import partial
from typing import NamedTuple

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs import Log
from tuning.identification.controller.fit import Candidate, LawFit, free_noise, search_law, with_covariance
from tuning.identification.controller.law import Law, Reading
from tuning.identification.controller.signals import Equation, every_sample, pieces, position_noise, snapshots

SAMPLES = range(1, 9)  # over which a velocity is differenced
DELAYS = range(-1, 4)  # rows from computing a command to logging it
SNAPSHOT_DELAYS = (-1, 0, 1)
CONVINCED = 15.1  # of chi squared with one degree of freedom: a chance of 1e-4 that noise alone shows so much
TRIED_ROWS = 8_000  # of a log, from which it is told how to read it: noise of so many rows is known to a hundredth


def fit_log(log: Log) -> LawFit:
    """The law of one log, as its rows are to be read.

    Raises `LogError` where the log has no reference, no stretch that can be used, or no cascade's command.
    """
    if log.reference is None:
        raise LogError(f"{log.name}: reference: is missing; a controller is told from reference, position and command")
    found = list(pieces(log))
    if not found:
        raise LogError(
            f"{log.name}: has no stretch that is long enough, without a gap and without a clipped command; log a "
            "longer motion"
        )
    reading = _reading(log, [_busiest(log, found)])
    whole = None
    if reading is not None:
        whole = search_law([reading.equation(log, piece) for piece in found], 1.0 / log.rate, reading.reading)
    if whole is None:
        raise LogError(
            f"{log.name}: command: does not push against the following error; check the signs of command and position, "
            "and that the reference is that of this axis"
        )
    return with_covariance(whole)


class _Choice(NamedTuple):
    """A way to read a log, and what it makes of the part that was tried."""

    reading: Reading
    equation: Callable[[Log, slice], Equation]
    candidate: Candidate


def _reading(log: Log, part: list[slice]) -> _Choice | None:
    """Every sample where that explains the noise of the command, and better than snapshots do."""
    choices = [one for one in (_every_sample(log, part), _snapshots(log, part)) if one is not None]
    return min(choices, key=lambda one: one.candidate.residual, default=None)


def _busiest(log: Log, found: list[slice]) -> slice:
    """`TRIED_ROWS` in a row, those with the longest way."""
    way = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(log.position)))])

    def parts() -> Iterator[tuple[float, slice]]:
        for piece in found:
            for start in range(piece.start, max(piece.stop - TRIED_ROWS, piece.start) + 1, TRIED_ROWS // 4):
                stop = min(start + TRIED_ROWS, piece.stop)
                yield float(way[stop - 1] - way[start]), slice(start, stop)

    return max(parts(), key=lambda part: part[0])[1]


def _every_sample(log: Log, part: list[slice]) -> _Choice | None:
    """With the samples and the delay that leave least before any law binds; the law then says how r' is taken.

    None where the noise of the position is left. Of snapshots the older sample of each velocity is not in the log, so
    that its noise is, gain times noise over time. Of every sample only rounding is: half of that variance is between.
    """

    def read(log: Log, piece: slice, samples: int, delay: int, backward: bool) -> Equation:
        return every_sample(log, piece, samples, delay, backward=backward)

    def left(choice: tuple[int, int]) -> float:
        return free_noise([read(log, piece, *choice, backward=False) for piece in part])

    samples, delay = min(itertools.product(SAMPLES, DELAYS), key=left)
    choices: list[_Choice] = []
    for backward in (True, False):
        equation = partial(read, samples=samples, delay=delay, backward=backward)
        found = search_law([equation(log, piece) for piece in part], 1.0 / log.rate, Reading.EVERY_SAMPLE)
        if found is not None:
            choices.append(_Choice(Reading.EVERY_SAMPLE, equation, found))
    best = min(choices, key=lambda one: one.candidate.residual, default=None)
    if best is None:
        return None
    gain = float(np.exp(best.candidate.solution.point[Law._fields.index("log_gain")]))
    noise = gain * position_noise(log, part) * log.rate / samples
    return best if best.candidate.residual**2 < 0.5 * noise**2 else None


def _snapshots(log: Log, part: list[slice]) -> _Choice | None:
    """The command of the position beside it only where its noise shows that: otherwise it has an instant of its own."""
    same: list[_Choice] = []
    own: list[_Choice] = []
    for delay in SNAPSHOT_DELAYS:
        equation = partial(snapshots, delay=delay)
        equations = [equation(log, piece) for piece in part]
        free = search_law(equations, 1.0 / log.rate, Reading.OWN_INSTANT)
        if free is None:
            continue
        if delay == 0:
            own.append(_Choice(Reading.OWN_INSTANT, equation, free))
        tied = search_law(equations, 1.0 / log.rate, Reading.SAME_INSTANT) if _moves_with_noise(free) else None
        if tied is not None:
            same.append(_Choice(Reading.SAME_INSTANT, equation, tied))
    return min(same or own, key=lambda one: one.candidate.cost, default=None)


def _moves_with_noise(free: Candidate) -> bool:
    """Whether the command moves with the noise of the position beside it, and against it, as feedback does.

    What the other moments fit badly is no doubt of this one: they are of motion, and it is of what motion leaves.
    """
    problem, point, *_ = free.solution
    jacobian = problem.jacobian(point)
    noise = point[Law._fields.index("noise")]
    variance = np.linalg.inv(jacobian.T @ jacobian)[-1, -1]
    return bool(noise > 0 and noise**2 > CONVINCED * variance)
