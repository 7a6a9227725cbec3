"""Motions and loads: as functions, as one line of text, and from files."""

from diffdrive.motion import load
from diffdrive.motion.builders import (
    chirp,
    constant_speed,
    from_array,
    jerk_limited,
    multisine,
    sine,
    staircase,
    trapezoidal,
    triangular,
)
from diffdrive.motion.motion import Limits, Motion

__all__ = [
    "Limits",
    "Motion",
    "chirp",
    "constant_speed",
    "from_array",
    "jerk_limited",
    "load",
    "multisine",
    "sine",
    "staircase",
    "trapezoidal",
    "triangular",
]
