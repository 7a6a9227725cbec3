"""The stretches of long logs that tell most of what may be missing.

A diagnosis costs in proportion to its seconds. What is missing may depend on place, on time or on direction, or show at
reversals alone: the stretches are those that determine functions of these best, beside the drive's parameters
(D-optimal design, as for an identification).
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffdrive.logs import Log
from diffdrive.model.parameters import Drive
from tuning.identification.informative import (
    LONGEST,
    STRETCH,
    Information,
    Stretches,
    best_stretches,
    cut,
    information_of,
    is_long,
    regressors,
)

PLACES, TIMES = 8, 6  # knots of the functions of position and time: as many as `LONGEST` has stretches, and fewer
FORWARDS, BACKWARDS = 3, 4  # of `regressors`: ones where the table moves that way
TURNED = 0.05  # s, that what a reversal shows lasts: a screw has crossed its play, and the bristle slides


def most_telling(logs: Sequence[Log], drive: Drive, seconds: float = LONGEST) -> Stretches:
    """At most so many seconds of the logs, the first stretch of each among them; all where they last less.

    With its first stretch a log keeps its beginning, from which the times of effects count.
    """
    cuts = [cut(log) for log in logs]
    if not is_long(logs, seconds) or not _are_whole(cuts, logs, seconds):
        return Stretches(tuple(logs), ())
    ends = [(float(log.position.min()), float(log.position.max())) for log in logs]
    low, high = min(low for low, _ in ends), max(high for _, high in ends)
    information = [_information(log, stretches, drive, low, high) for log, stretches in zip(logs, cuts, strict=True)]
    return best_stretches(logs, cuts, information, seconds, [(k, 0) for k in range(len(logs))])


def _are_whole(cuts: Sequence[Sequence[tuple[int, int]]], logs: Sequence[Log], seconds: float) -> bool:
    """Whether stretches can be chosen: of few logs, each from its first sample on, in pieces as long as a stretch."""
    if not all(cuts) or 2 * len(logs) * STRETCH > seconds or any(stretches[0][0] for stretches in cuts):
        return False
    lasting = [(last - first) / log.rate for log, each in zip(logs, cuts, strict=True) for first, last in each]
    return float(np.mean(lasting)) >= 0.5 * STRETCH


def _information(
    log: Log, stretches: Sequence[tuple[int, int]], drive: Drive, low: float, high: float
) -> list[Information]:
    """Of each stretch, of the drive's parameters and of functions of position, time and direction."""
    known = regressors(log, drive)
    places = np.linspace(low, high, PLACES)
    times = np.linspace(log.time[0], log.time[-1], TIMES)
    turned = _turned(known[:, FORWARDS] - known[:, BACKWARDS], round(TURNED * log.rate))
    found = []
    for first, last in stretches:
        rows = known[first:last]
        way, moves = rows[:, FORWARDS] - rows[:, BACKWARDS], rows[:, FORWARDS] + rows[:, BACKWARDS]
        at_place, at_time = _hats(log.position[first:last], places), _hats(log.time[first:last], times)
        columns = [rows, at_place * way[:, None], at_place * moves[:, None], at_time * way[:, None], turned[first:last]]
        found.append(information_of(np.hstack(columns), log.rate))
    return found


def _hats(values: Float[np.ndarray, " n"], knots: Float[np.ndarray, " k"]) -> Float[np.ndarray, "n k"]:
    """Functions that are one at a knot of even ones and fall to zero at the next."""
    step = max(float(knots[1] - knots[0]), 1e-12)
    return np.maximum(0.0, 1.0 - np.abs(values[:, None] - knots) / step)


def _turned(way: Float[np.ndarray, " n"], lasts: int) -> Float[np.ndarray, "n 2"]:
    """Ones for so many samples from where the table moves again, the other way than before: upwards, and downwards."""
    moving = np.flatnonzero(way)
    turns = moving[1:][way[moving[1:]] != way[moving[:-1]]]
    found = np.zeros((len(way), 2))
    for turn in turns:
        found[turn : turn + lasts, 0 if way[turn] > 0 else 1] = 1.0
    return found
