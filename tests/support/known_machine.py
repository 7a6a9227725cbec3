"""A machine whose parameters are known, and the drive that is believed in its place."""

import numpy as np

from diffdrive.controllers import PDGains
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from experiments.studies.recovery.random_drive import random_drive

RATE = 2_000.0
GAINS = PDGains(PAPER_KP, PAPER_KD)
BELIEVED = paper_drive()
MACHINE = random_drive(np.random.default_rng(1))


def by_name(found):
    return {one.name: one for one in found.estimates}
