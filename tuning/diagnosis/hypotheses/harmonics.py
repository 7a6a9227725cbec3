"""Waves by their own period: what is above all a harmonic of a longer wave is a wave of that harmonic's period."""

import numpy as np

from diffdrive.effects.forces import Cogging, ProcessForce
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import Vector

RATES = {Cogging: ("period", -1.0), ProcessForce: ("frequency", 1.0)}  # a harmonic's own, as its order to a power
ORDERS = {"": 1.0, "2": 2.0, "6": 6.0}  # of the harmonics, by how the names of their amplitudes end

Values = dict[str, Vector]


def at_its_root(candidate: Candidate, values: Values) -> Values:
    """The strongest harmonic of a wave, told as an engineer would call it: not the second harmonic of a ripple every
    other turn of the screw but one every turn. Whether the others have to be there too is for a fit to say. What has
    no stronger harmonic than its first stays as it is.
    """
    if candidate.effect not in RATES:
        return values
    strongest = max((order for order in ORDERS if f"cosine{order}" in values), key=lambda order: _size(values, order))
    if strongest == "":
        return values
    name, power = RATES[candidate.effect]
    gone = {key: 0.0 * value for key, value in values.items() if key.startswith(("cosine", "sine"))}
    cosine, sine = _wave(values, strongest)
    return values | gone | {name: ORDERS[strongest] ** power * values[name], "cosine": cosine, "sine": sine}


def _size(values: Values, order: str) -> float:
    """The largest amplitude of a harmonic in any log."""
    return float(np.max(np.hypot(*_wave(values, order))))


def _wave(values: Values, order: str) -> tuple[Vector, Vector]:
    """Cosine and sine of one harmonic, log by log."""
    return values[f"cosine{order}"], values[f"sine{order}"]
