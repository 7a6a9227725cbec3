"""Whether something happens, once and briefly, in logs that lack nothing else.

What lasts for milliseconds only, such as a force limit that few samples reach, is lost in the likelihood of tens of
thousands of others. So the squares of the innovations are added up over a moment, and the largest sum is held against
what chance makes of so many.
"""

from typing import NamedTuple

import numpy as np
from scipy.stats import chi2

from tuning.diagnosis.fitting import Fitted
from tuning.diagnosis.following import LOST
from tuning.diagnosis.verdict import Verdict

MOMENT = 5e-3  # s
CHANCE = -6.0  # decades: sound machines come to -2 at the least, a limit that ten samples reach to -40


class Event(NamedTuple):
    """The moment at which a machine moves least as foreseen."""

    lane: int
    begins: int  # sample
    samples: int
    decades: float  # of the chance that noise makes as much anywhere


def least_foreseen(fitted: Fitted) -> Event:
    """That moment of the logs.

    How far a single sample is off beyond `LOST` says no more: one count that went astray is no event.
    """
    logged, track = fitted.model.logged, fitted.track
    unit = np.asarray(track.scatter) * np.sqrt(float(track.size))
    off = np.minimum(np.abs(np.asarray(track.innovation) / unit), LOST)
    squares = np.where(np.isfinite(off), off, LOST) ** 2 * np.asarray(logged.lanes.counts)
    wide = min(max(1, round(MOMENT * logged.sampling.rate)), squares.shape[1])
    sums = np.lib.stride_tricks.sliding_window_view(squares, wide, axis=1).sum(axis=2)
    lane, begins = np.unravel_index(int(sums.argmax()), sums.shape)
    decades = (chi2.logsf(sums[lane, begins], wide) + np.log(sums.size)) / np.log(10.0)
    return Event(int(lane), int(begins), wide, float(min(decades, 0.0)))


def doubted_by_event(verdict: Verdict, fitted: Fitted) -> Verdict:
    """`unknown` in the place of `none` where something happens that the drive does not foresee."""
    event = least_foreseen(fitted)
    if verdict.verdict != "none" or event.decades > CHANCE:
        return verdict
    logged = fitted.model.logged
    at = float(logged.starts[event.lane]) + event.begins * logged.sampling.period
    says = (
        f"the recalibrated drive explains the logs to the noise but for a moment: about {at:.3f} s into log "
        f"{logged.owner[event.lane] + 1} the table moves as neither it nor any effect foresees "
        f"(noise does so once in 1e{-event.decades:.0f} logs)"
    )
    return verdict.doubted(says)._replace(says=says)
