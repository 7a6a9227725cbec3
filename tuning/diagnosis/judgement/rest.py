"""What becomes of the stretches of long logs that were not diagnosed: what was found is held against them.

It is told and decides nothing: how much a model may leave in data that it was not fitted to is not known yet.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.logs import Log
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.reference_noise import Forces
from tuning.diagnosis.gap.gap import ForceGap, force_gap
from tuning.diagnosis.hypotheses.model import Logged
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import initial_trajectory
from tuning.identification.informative import STRETCH, cut
from tuning.identification.problem import long_pieces


class Rest(NamedTuple):
    """What was found, held against the stretches that were not diagnosed: RMS of the missing force (N)."""

    seconds: float
    missing: float
    recalibrated: float  # without what was found
    diagnosed: float  # with it, in the stretches that were
    worst: float  # in the stretch of the rest where most is missing
    log: str  # which that is in
    start: float  # s, of that log

    @property
    def says(self) -> str:
        """All of it."""
        return (
            "these logs are long: the stretches that tell most were diagnosed, and what was found was held against the "
            f"other {self.seconds:.3g} s; {self.missing:.3g} N of force are missing there (recalibrated: "
            f"{self.recalibrated:.3g} N; where it was looked for: {self.diagnosed:.3g} N), most of it, "
            f"{self.worst:.3g} N, in the {STRETCH:g} s from {self.start:.4g} s of {self.log}"
        )


def held_against(
    logged: Logged, logs: Sequence[Log], diagnosed: Sequence[Log], found: Explanation, process_noise: Forces
) -> Rest:
    """What was found in `diagnosed`, stretches of the logs that are `logged`, held against all of them.

    The missing force is what a filter with this `process_noise` (N) needs.
    """
    fitter = Fitter(logged)
    base, best = (_followed(fitter, one) for one in (found.base, found.best))
    gaps = [force_gap(fitter, one, process_noise) for one in (base, best)]
    before, after = (_by_stretch(gap, logs, logged.thinning) for gap in gaps)
    inside = np.array(
        [
            np.isin(log.time[first], part.time).item()
            for log, part in zip(logs, diagnosed, strict=True)
            for first, _ in cut(log)
        ]
    )
    places = [(log, log.time[first] - log.time[0]) for log in logs for first, _ in cut(log)]
    each = np.where(inside | (after[:, 1] == 0.0), -np.inf, after[:, 0] / np.maximum(after[:, 1], 1.0))
    worst = int(np.argmax(each))
    return Rest(
        seconds=sum((last - first) / log.rate for log in logs for first, last in cut(log)) - _seconds(diagnosed),
        missing=_rms(after[~inside]),
        recalibrated=_rms(before[~inside]),
        diagnosed=_rms(after[inside]),
        worst=_rms(after[[worst]]),
        log=places[worst][0].name,
        start=float(places[worst][1]),
    )


def _seconds(logs: Sequence[Log]) -> float:
    return sum((piece.stop - piece.start) / log.rate for log in logs for piece in long_pieces(log))


def _followed(fitter: Fitter, fitted: Fitted) -> Fitted:
    """A fit on other stretches of its logs, under the process forces that are likeliest there; nothing is fitted."""
    model = fitted.model.on(fitter.logged)
    point = fitter.at(model, fitted.theta, fitted.process_noise, initial_trajectory(fitter.logged))
    point = fitter.settled(model, point.theta, point.process_noise, point.next_trajectory)
    point = fitter.with_process(point, model, np.vstack([point.process_noise, fitter.first]))
    return fitted._replace(
        model=model, process_noise=point.process_noise, cost=point.cost, filtered=point.filtered,
        signals=point.signals, recalibrated_drive=point.recalibrated_drive, drive=point.drive,
    )  # fmt: skip


def _by_stretch(gap: ForceGap, logs: Sequence[Log], thinning: int) -> Float[np.ndarray, "stretches 2"]:
    """Sum of the squares of the force that is missing, and of the samples that count, in each stretch of each log."""
    found, lane = [], 0
    for log in logs:
        for piece in long_pieces(log):
            for first, last in cut(log):
                if piece.start <= first < piece.stop:
                    rows = slice((first - piece.start) // thinning, (last - piece.start) // thinning)
                    found.append([np.sum(gap.force[lane, rows] ** 2), np.sum(gap.counts[lane, rows])])
            lane += 1
    return np.array(found)


def _rms(sums: Float[np.ndarray, "k 2"]) -> float:
    squares, counts = sums.sum(axis=0)
    return float(np.sqrt(squares / max(counts, 1.0)))
