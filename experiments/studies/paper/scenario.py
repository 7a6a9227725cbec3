"""Lee et al. 2015 as a scenario: the canonical reading of what the paper leaves open (docs/evidence/paper.md)."""

from dataclasses import dataclass

import numpy as np

from diffdrive.controllers import Controller
from diffdrive.loop.run import Run
from diffdrive.model.parameters import Drive
from diffdrive.motion import load
from diffdrive.motion.builders import triangular
from diffdrive.motion.motion import Motion
from diffdrive.paper import LIMITS, SAMPLING, example_controllers

__all__ = [
    "AFTER_LOAD",
    "BEFORE_LOAD",
    "LIMITS",
    "MAX_LOAD",
    "SAMPLING",
    "TABLE_1",
    "TABLE_4",
    "PaperScenario",
    "canonical",
    "controllers",
    "settled_rms",
]

KINDS = ("pd", "dobvsc", "pd+ff+dob", "pd+fc", "pd+fc+le", "pd+fc+ls")
AFTER_LOAD = (4.0, 4.2)  # s: the reversal under load, Table 1
BEFORE_LOAD = (2.0, 2.2)  # s: the same reversal without load
MAX_LOAD = 12_600.0  # N, the testbed's highest

# Table 1: peak and RMS tracking error in um at 4 to 4.2 s
TABLE_1 = {
    "PD": (12.0, 10.2),
    "DOBVSC": (2.4, 0.9),
    "PD+FF+DOB": (1.2, 0.6),
    "PD+FC": (0.7, 0.3),
    "PD+FC+LE": (0.7, 0.2),
}

# Table 4: load kN -> friction estimation error N (FC, LE), tracking error um (FC, LE), estimated load kN; all RMS
TABLE_4 = {10.9: (3.08, 1.18, 1.65, 0.98, 10.9), 12.6: (4.95, 1.05, 2.18, 1.10, 13.1)}


@dataclass(frozen=True)
class PaperScenario:
    """A motion and the load (N, per sample) that goes with it."""

    motion: Motion
    load: np.ndarray


def canonical() -> PaperScenario:
    """Fig. 7 as we read it: 10 mm/s, reversals over 0.3 s centred at 2.05 and 4.05 s, 0 to 10 kN from 2.5 to 3.5 s."""
    # reversals 2 s apart
    motion = triangular(speed=0.010, stroke=0.0185, rounding=0.3, duration=4.5, rate=SAMPLING.rate, first_reversal=2.05)
    return PaperScenario(motion, load.ramp(motion.time, start=2.5, end=3.5, to=10_000.0))


def controllers(drive: Drive) -> dict[str, Controller]:
    """The paper's five controllers, and ours, with a model of exactly this drive."""
    examples = example_controllers(drive)
    return {kind.upper(): examples[kind] for kind in KINDS}


def settled_rms(signal: np.ndarray, run: Run, start: float = 4.0) -> float:
    """RMS at constant speed from `start` (s) on, when the load estimators have settled."""
    speed = np.abs(run.reference_velocity)
    cruising = (run.time >= start) & (speed > 0.999 * speed.max())
    return float(np.sqrt(np.mean(signal[cruising] ** 2)))
