"""The most informative stretches of long logs: a fit costs in proportion to its seconds, and the rest can judge it.

Which stretches is a question of the regressors of inverse dynamics alone, so it is answered before anything is fitted:
mass, viscous and Coulomb friction and the Stribeck curve in each direction, and the slope over the load. Stretches are
taken one by one, each time the one that raises the determinant of the information most (D-optimal design, Fedorov
1972; greedy, for it is submodular).
"""

import dataclasses
import itertools
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.logs import Log
from diffdrive.logs.log import CHANNELS
from diffdrive.model.parameters import Drive
from tuning.identification.problem import MIN_LANE_SAMPLES, lanes_of, long_pieces, noise_floor
from tuning.identification.shown_motion import shown_velocity

LONGEST = 40.0  # s that are fitted at most: about a minute of searching on two cores
STRETCH = 5.0  # s: several strokes, and long beside the 0.1 s in which a filter finds the state it began with
SMOOTHING = 20e-3  # s, over which an acceleration is taken
LEAST = 1e-9  # of the information of all: what a direction has that nothing has shown yet

Information = Float[np.ndarray, "p p"]


class Stretches(NamedTuple):
    """Logs of what is fitted, and of the rest, which is held out."""

    fitted: tuple[Log, ...]
    rest: tuple[Log, ...]

    @property
    def note(self) -> str:
        """What was done; empty where all is fitted."""
        if not self.rest:
            return ""
        chosen, others = (sum(_seconds(log) for log in logs) for logs in (self.fitted, self.rest))
        return (
            f"these logs last {chosen + others:.3g} s: fitted are the {chosen:.3g} s of them that determine most, in "
            f"stretches of {STRETCH:g} s, and the other {others:.3g} s are held out"
        )


def most_informative(logs: Sequence[Log], drive: Drive, seconds: float = LONGEST) -> Stretches:
    """At most so many seconds of the logs, those that determine the drive's parameters best; all where they last less.

    A log that is fitted in part is in both, under its name; where it is cut it has gaps.
    """
    if not is_long(logs, seconds):
        return Stretches(tuple(logs), ())
    cuts = [cut(log) for log in logs]
    information = [
        [information_of(columns[first:last], log.rate) for first, last in stretches]
        for log, stretches, columns in zip(logs, cuts, (regressors(log, drive) for log in logs), strict=True)
    ]
    return best_stretches(logs, cuts, information, seconds)


def is_long(logs: Sequence[Log], seconds: float = LONGEST) -> bool:
    """Whether the logs last longer than so many seconds."""
    return sum(_seconds(log) for log in logs) > seconds


def best_stretches(
    logs: Sequence[Log],
    cuts: Sequence[Sequence[tuple[int, int]]],
    information: Sequence[Sequence[Information]],
    seconds: float,
    begun: Collection[tuple[int, int]] = (),
) -> Stretches:
    """Those of the `cuts` whose information together has the largest determinant, for so many seconds.

    `begun` are some that are taken anyway: the number of the log, and that of the stretch in it.
    """
    every = [(k, number) for k, stretches in enumerate(cuts) for number in range(len(stretches))]
    first = [every.index(one) for one in begun]
    order = _greedy(np.array([information[k][number] for k, number in every]), max(1, int(seconds / STRETCH)), first)
    chosen = {(every[k][0], cuts[every[k][0]][every[k][1]]) for k in order}
    fitted, rest = [], []
    for k, (log, stretches) in enumerate(zip(logs, cuts, strict=True)):
        mine = [stretch for stretch in stretches if (k, stretch) in chosen]
        others = [stretch for stretch in stretches if (k, stretch) not in chosen]
        fitted += [_part(log, mine)] if mine else []
        rest += [_part(log, others)] if others else []
    return Stretches(tuple(fitted), tuple(rest))


def _seconds(log: Log) -> float:
    return sum(piece.stop - piece.start for piece in long_pieces(log)) / log.rate


def cut(log: Log) -> list[tuple[int, int]]:
    """The log's pieces in equal stretches of `STRETCH` and less, by their first and last sample."""
    found = []
    for piece in long_pieces(log):
        count = piece.stop - piece.start
        parts = max(1, min(int(np.ceil(count / (STRETCH * log.rate))), count // MIN_LANE_SAMPLES))
        edges = np.linspace(piece.start, piece.stop, parts + 1).astype(int).tolist()
        found += list(itertools.pairwise(edges))
    return found


def information_of(columns: Float[np.ndarray, "n p"], rate: float) -> Information:
    """The squares and products of regressors, summed over the samples of a stretch."""
    return columns.T @ columns / rate


def regressors(log: Log, drive: Drive) -> Float[np.ndarray, "n p"]:
    """What each parameter's force is in proportion to, at every sample at which the table moves for certain."""
    lanes, rate = lanes_of([log]), log.rate
    counts = np.asarray(lanes.counts) > 0
    noise = noise_floor(drive, lanes, rate)
    window, differenced, slowest = shown_velocity(np.asarray(lanes.position), counts, noise, rate)
    columns = np.zeros((len(log.time), 8))
    load = np.zeros(len(log.time)) if log.load is None else log.load + float(drive.friction.initial_load)
    pair, exponent = drive.friction.stribeck_velocity, float(drive.friction.exponent)
    for lane, piece in enumerate(long_pieces(log)):
        if piece.stop - piece.start <= max(window, round(SMOOTHING * rate)):
            continue  # too short to show a velocity
        velocity = np.zeros(piece.stop - piece.start)
        velocity[window // 2 : window // 2 + len(velocity) - window] = differenced[lane, : len(velocity) - window]
        velocity[np.abs(velocity) < slowest] = 0.0
        smooth = max(1, round(SMOOTHING * rate))
        acceleration = np.zeros_like(velocity)
        acceleration[smooth // 2 : smooth // 2 + len(velocity) - smooth] = (
            (velocity[smooth:] - velocity[:-smooth]) * rate / smooth
        )
        forwards, backwards = velocity > 0, velocity < 0
        falls = forwards * np.exp(-((np.abs(velocity) / float(pair.positive)) ** exponent))
        rises = backwards * np.exp(-((np.abs(velocity) / float(pair.negative)) ** exponent))
        columns[piece] = np.stack(
            [
                acceleration, forwards * velocity, backwards * velocity, forwards, backwards, falls, rises,
                np.sign(velocity) * load[piece],
            ],
            axis=1,
        )  # fmt: skip
    return columns


def _greedy(information: Float[np.ndarray, "s p p"], count: int, begun: Sequence[int]) -> list[int]:
    """Indices of `count` stretches: those that are begun with, then each the one that raises the determinant most."""
    total = information.sum(axis=0)
    shown = np.diag(total) > 0.0
    scale = 1.0 / np.sqrt(np.diag(total)[shown])
    scaled = information[:, shown][:, :, shown] * np.outer(scale, scale)
    order = list(begun)
    known = LEAST * np.eye(int(shown.sum())) + scaled[order].sum(axis=0)
    for _ in range(min(count, len(information)) - len(order)):
        gains = np.linalg.slogdet(known + scaled)[1]
        gains[order] = -np.inf
        best = int(np.argmax(gains))
        order.append(best)
        known = known + scaled[best]
    return order


def _part(log: Log, stretches: Sequence[tuple[int, int]]) -> Log:
    """The log with these stretches alone, a gap between any two."""
    kept = np.concatenate([np.arange(first, last) for first, last in stretches])
    lengths = np.cumsum([last - first for first, last in stretches])[:-1]
    signals = {name: getattr(log, name)[kept] for name in CHANNELS if getattr(log, name, None) is not None}
    return dataclasses.replace(log, gaps=tuple(int(place) for place in lengths), **signals)
