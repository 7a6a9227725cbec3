"""Where a screw between motor and table is looked for: a few points, then one of its numbers after the other.

The cost of a gap is steep near the truth and flat far from it, so no slope leads there. Beside free functions it is far
smoother: they take what a wrong gap leaves of friction and of lasting forces.
"""

from collections.abc import Iterator, Mapping

import numpy as np

from diffdrive.effects.transmission import Backlash
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.selection.screening import Values
from tuning.hypotheses.table import Entry, Table, by_change

SHARED = {"damping": 0.03, "motor_share": 0.4, "table_friction": 0.5}
LOOSE = [
    SHARED | {"gap": float(gap), "frequency": 400.0, "damping": 0.08} for gap in 2e-6 * 1.35 ** np.arange(9)
]  # m, Hz
ELASTIC = [SHARED | {"frequency": frequency} for frequency in (60.0, 100.0, 160.0, 250.0, 400.0)]  # Hz
STEPS = {"gap": 0.12, "frequency": 0.25, "damping": 0.8, "motor_share": 0.15, "table_friction": 0.2}
PARTS = ("motor_share", "table_friction")  # stepped as they are, the others by their logarithm
SWEEPS = 3  # each of half the steps of the one before

Place = Mapping[str, float]


def places(candidate: Candidate, logs: int) -> list[Values]:
    """Where a kind of screw is looked for at first."""
    return [_everywhere(one, logs) for one in (LOOSE if candidate.effect is Backlash else ELASTIC)]


def refined(fitter: Fitter, table: Table, best: Entry) -> Entry:
    """From there along one number after the other, as long as that explains more."""
    candidate, logs = best.candidate, table.fitted.model.logged.logs
    there: Place = {name: float(value[0]) for name, value in best.values.items()}
    for sweep in range(SWEEPS):
        for name in there:
            for sign in (1.0, -1.0):
                began = best
                for place in _along(candidate, there, name, sign * 0.5**sweep):
                    other = by_change(fitter, table, candidate, _everywhere(place, logs))
                    if not other.evidence > best.evidence:
                        break
                    best, there = other, place
                if best is not began:
                    break  # it is no better the other way
    return best


def _along(candidate: Candidate, there: Place, name: str, share: float) -> Iterator[Place]:
    """Further and further along one number, as far as its bounds."""
    value = there[name]
    while True:
        value = value + share * STEPS[name] if name in PARTS else value * float(np.exp(share * STEPS[name]))
        place = {**there, name: value}
        if not all(low < place[bound] < high for bound, low, high in candidate.bounds) or not _is_share(place):
            return
        yield place


def _is_share(place: Place) -> bool:
    return all(0.0 < place[name] < 1.0 for name in PARTS)


def _everywhere(place: Place, logs: int) -> Values:
    return {name: np.full(logs, value) for name, value in place.items()}
