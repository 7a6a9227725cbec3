"""Required margins of the loop with a measured plant, beside those of the model's."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.frequency.response import FrequencyResponse, require_response
from diffdrive.linearisation import StabilityMargins
from diffdrive.loop.linearise import OperatingPoint, open_loop
from diffdrive.loop.margins import Margins
from diffdrive.loop.measured import MeasuredPlant, measured_margins
from diffdrive.measured_loop import measured_loop
from diffdrive.model.parameters import Drive, Sampling

NAME = "measured "  # before the name of a requirement of the measured loop


class MeasuredMachine(NamedTuple):
    """A measured plant, and the drive and the motion about which it stands for the machine."""

    drive: Drive  # smooth, every number an array
    point: OperatingPoint
    plant: MeasuredPlant

    def margins(self, controller: Controller, sampling: Sampling) -> Margins:
        """Those of the loop with the measured plant; `controller` is the smooth variant."""
        return measured_margins(open_loop(self.drive, controller, sampling, self.point), self.plant)


class MeasuredMargins(NamedTuple):
    """The margins of the loop with a measured plant, with the gains as given and as tuned."""

    name: str
    before: StabilityMargins
    after: StabilityMargins


def responses_of(measured: object) -> tuple[FrequencyResponse, ...]:
    """One measured response or several; raises `ParameterError` for what is none."""
    responses: Sequence[Any] = measured if isinstance(measured, list | tuple) else [measured]
    for one in responses:
        require_response(one)
    return tuple(responses)


def measured_margins_of(
    axis: Axis, tuned: Controller, measured: Sequence[FrequencyResponse], velocity: float, load: float
) -> tuple[MeasuredMargins, ...]:
    """Of each response, on the axis's own rate."""

    def margins(one: FrequencyResponse, controller: Controller) -> StabilityMargins:
        moved = axis.with_controller(controller)
        return measured_loop(moved, one, velocity=velocity, load=load, measured_with=axis).margins()

    return tuple(MeasuredMargins(one.name, margins(one, axis.controller), margins(one, tuned)) for one in measured)
