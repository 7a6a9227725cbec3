"""The controller of a drive file that has the gains that were found."""

from collections.abc import Sequence

from diffdrive.controllers.base import Feedforward
from diffdrive.controllers.cascade import Cascade
from diffdrive.model.parameters import Drive
from tuning.identification.controller.gains import Gain


def cascade_of(gains: Sequence[Gain], drive: Drive, samples: int) -> Cascade:
    """A cascade whose velocity is differenced over so many samples; what the logs do not tell from zero is left out.

    Its feed-forward of acceleration is a share of that of the drive's mass, as drive files state it.
    """
    found = {gain.name: gain.value if gain.determined else 0.0 for gain in gains}
    mass, forward = found["acceleration_feedforward"], max(0.0, found["velocity_feedforward"])
    feedforward = Feedforward.of(drive.plant) if mass > 0 else None
    share = mass / float(drive.plant.mass) if mass > 0 else None
    return Cascade(
        kp=found["kp"],
        kv=found["kv"],
        velocity_feedforward=forward,
        feedforward=feedforward,
        force_feedforward=share,
        velocity_samples=samples,
        reset_time=found["reset_time"] if found["reset_time"] > 0 else None,
    )
