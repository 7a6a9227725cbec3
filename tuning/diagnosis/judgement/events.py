"""Whether something happens, once and briefly, in logs that lack nothing else.

What lasts for milliseconds only, such as a force limit that few samples reach, is lost in the likelihood of tens of
thousands of others. So the squares of the innovations are added up over a moment, and the largest sum is held against
what chance makes of so many.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.judgement.verdict import Verdict
from tuning.diagnosis.levels import CHANCE, LOST

MOMENT, SHORTEST = 5e-3, 3  # s, and samples at least
SETTLED = 3  # samples after one at which the filter was lost


class Event(NamedTuple):
    """The moment at which a machine moves least as foreseen."""

    lane: int
    begins: int  # sample
    samples: int
    decades: float  # of the chance that noise makes as much anywhere


def least_foreseen(fitted: Fitted) -> Event:
    """That moment of the logs.

    Samples at and after a loss of the filter do not count. A table at rest does not lower the noise that is expected.
    Within two neighbouring counts the error of a count is the same from sample to sample: only what exceeds half a
    count is summed.
    """
    logged, filtered = fitted.model.logged, fitted.filtered
    unit = np.asarray(filtered.innovation_std) * np.sqrt(max(float(filtered.noise_scale_sq), 1.0))
    off = np.abs(np.asarray(filtered.innovation) / unit)
    lost = ~(off <= LOST)
    for _ in range(SETTLED):
        lost[:, 1:] |= lost[:, :-1]
    counted = np.where(lost, 0.0, np.asarray(logged.lanes.counts))
    wide = min(max(SHORTEST, round(MOMENT * logged.sampling.rate)), off.shape[1])
    count = float(logged.drive.sensor.resolution or 0.0)
    beyond = np.maximum(off - 0.5 * count / unit, 0.0)
    shown = np.lib.stride_tricks.sliding_window_view(np.asarray(logged.lanes.position), wide, axis=1)
    neighbours = np.ptp(shown, axis=2) < 1.5 * count
    moving, resting, freedom = (
        _summed(one, wide)
        for one in (np.where(lost, 0.0, off) ** 2 * counted, np.where(lost, 0.0, beyond) ** 2 * counted, counted)
    )
    sums = np.where(neighbours, resting, moving)
    logs = np.where(freedom > 0.0, chi2.logsf(sums, np.maximum(freedom, 1.0)), 0.0)
    lane, begins = np.unravel_index(int(logs.argmin()), logs.shape)
    decades = (logs[lane, begins] + np.log(max(int(np.count_nonzero(freedom)), 1))) / np.log(10.0)
    return Event(int(lane), int(begins), wide, float(min(decades, 0.0)))


def _summed(each: Float[np.ndarray, "lanes n"], wide: int) -> Float[np.ndarray, "lanes m"]:
    """Over every so many samples."""
    return np.lib.stride_tricks.sliding_window_view(each, wide, axis=1).sum(axis=2)


def downgraded_by_event(verdict: Verdict, fitted: Fitted) -> Verdict:
    """`unknown` in the place of `none` where something happens that the drive does not foresee."""
    if verdict.verdict != "none":
        return verdict
    event = least_foreseen(fitted)
    if event.decades > np.log10(CHANCE):
        return verdict
    logged = fitted.model.logged
    at = float(logged.starts[event.lane]) + event.begins * logged.sampling.period
    says = (
        f"the recalibrated drive explains the logs to the noise but for a moment: about {at:.3f} s into log "
        f"{logged.owner[event.lane] + 1} the table moves as neither it nor any effect that was looked for predicts "
        f"(noise does so once in 1e{-event.decades:.0f} logs)"
    )
    return verdict.downgraded(says)._replace(says=says)
