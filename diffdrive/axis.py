"""An axis: the machine, its controller, and how both are sampled, limited and logged."""

import dataclasses

from diffdrive.controllers import Controller
from diffdrive.logs.mapping import Mapping
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.motion.motion import Limits


@dataclasses.dataclass(frozen=True)
class Axis:
    """A drive file's content: the drive, its controller, sampling, the limits of the axis, and how its logs read."""

    drive: Drive
    controller: Controller
    sampling: Sampling
    limits: Limits
    mapping: Mapping = dataclasses.field(default_factory=Mapping)
