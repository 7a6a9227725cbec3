"""The drive, rate and units that all parts of the benchmark share."""

from diffdrive.controllers import Controller
from diffdrive.model.parameters import Drive
from diffdrive.model.presets import paper_drive
from experiments.benchmarks import clock
from experiments.studies.paper import scenario as paper

RATE = 10_000.0
TUNER_SUBSTEPS = 3  # substeps, as the tuner takes them


def nominal() -> tuple[Drive, Controller]:
    """The paper's drive and its controller, PD+FC+LE."""
    drive = paper_drive()
    return drive, paper.controllers(drive)["PD+FC+LE"]


def ns_per_step(timing: clock.Timing, steps: int, lanes: int = 1) -> float:
    """Nanoseconds of a step of a lane, of the best round."""
    return 1e9 * timing.best / (steps * lanes)
