"""What every part of the benchmark runs."""

from diffdrive.controllers import Controller
from diffdrive.model.parameters import Drive
from diffdrive.model.presets import paper_drive
from experiments.benchmarks import clock
from experiments.studies.paper import scenario as paper

RATE = 10_000.0
COARSE = 3  # substeps, as the tuner takes them


def nominal() -> tuple[Drive, Controller]:
    """The paper's drive and its own controller."""
    drive = paper_drive()
    return drive, paper.controllers(drive)["PD+FC+LE"]


def nanoseconds(timing: clock.Timing, steps: int, lanes: int = 1) -> float:
    """Of a step of a lane, at best."""
    return 1e9 * timing.best / (steps * lanes)
