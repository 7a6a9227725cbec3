"""Waves by their own period: what is hardly more than its second harmonic is a wave of half the period."""

import numpy as np

from diffdrive.effects.forces import Cogging, ProcessForce
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import Vector

ROOTS = {Cogging: ("period", 0.5), ProcessForce: ("frequency", 2.0)}  # what is to be halved, or doubled
ORDERS = ("", "2", "6")  # harmonics, as the names of their amplitudes end
PURE = 0.1  # of the second harmonic, that all others may be where it stands for all

Values = dict[str, Vector]


def at_its_root(candidate: Candidate, values: Values) -> Values:
    """The same wave as an engineer would call it: not the second harmonic of a ripple every other turn of the screw
    but one every turn. What is no such wave stays as it is.
    """
    known = ROOTS.get(candidate.effect)
    if known is None:
        return values
    sizes = {order: float(np.max(np.hypot(*_wave(values, order)))) for order in ORDERS if f"cosine{order}" in values}
    second = sizes.pop("2")
    if max(sizes.values()) > PURE * second:
        return values
    name, factor = known
    gone = {key: 0.0 * value for key, value in values.items() if key.startswith(("cosine", "sine"))}
    cosine, sine = _wave(values, "2")
    return values | gone | {name: factor * values[name], "cosine": cosine, "sine": sine}


def _wave(values: Values, order: str) -> tuple[Vector, Vector]:
    """Cosine and sine of one harmonic, log by log."""
    return values[f"cosine{order}"], values[f"sine{order}"]
