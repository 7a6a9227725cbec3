"""A drive that the tests of effects share, with its controller and its rate, and effects for it."""

import dataclasses

from diffdrive.controllers import PD
from diffdrive.controllers.base import PDGains, Tracking
from diffdrive.model.parameters import Sampling, Sensor
from diffdrive.model.presets import paper_drive

RATE = 2_000.0
SAMPLING = Sampling(rate=RATE)
CONTROLLER = PD(Tracking(PDGains(1.0e6, 6_000.0)))
DRIVE = dataclasses.replace(paper_drive(), sensor=Sensor(None, 0.0))


def with_effects(*effects, drive=DRIVE):
    return dataclasses.replace(drive, effects=effects)
