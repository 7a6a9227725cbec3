"""A drive and its PD+FC+LE controller as the row of numbers that the hand-written steps take."""

from typing import NamedTuple

import numpy as np

from diffdrive.controllers import Controller, Feedforward, FrictionCompensation
from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Drive, Friction, Plant
from diffdrive.model.quantity import Directional
from diffdrive.observers.friction_observer import KalmanObserver
from diffdrive.observers.load_estimator import InnovationLoad


class LaneParameters(NamedTuple):
    """The parameters of one lane, in the order of `step.c`."""

    machine: list[float]
    model: list[float]
    resolution: float
    gains: list[float]
    observer: list[float]
    load_amplitude: float

    @property
    def numbers(self) -> np.ndarray:
        """All in one row."""
        return np.r_[self.machine, self.model, self.resolution, self.gains, self.observer, self.load_amplitude].astype(
            float
        )


def _pair(value: Directional) -> list[float]:
    return [float(value.positive), float(value.negative)]


def _machine(plant: Plant, friction: Friction) -> list[float]:
    return [
        float(plant.mass), *_pair(plant.damping), float(plant.constant_force), *_pair(friction.coulomb_screw),
        *_pair(friction.load_coefficient), float(friction.initial_load), *_pair(friction.breakaway_gap),
        *_pair(friction.stribeck_velocity), *_pair(friction.viscous), *_pair(friction.bristle_stiffness),
        *_pair(friction.bristle_damping),
    ]  # fmt: skip


def lane_parameters(drive: Drive, controller: Controller, load_amplitude: float = 1.0) -> np.ndarray:
    """The numbers of one lane; its load is `load_amplitude` times the one that all lanes share.

    Raises `ParameterError` for what the hand-written steps have not: limits, delays, effects, noise, other controllers.
    """
    observer = controller.observer if isinstance(controller, FrictionCompensation) else None
    estimator = observer.load_estimator if isinstance(observer, KalmanObserver) else None
    plain = drive.actuator.force_limit is None and not drive.actuator.delay_samples and not drive.effects
    if not (
        isinstance(controller, FrictionCompensation)
        and isinstance(observer, KalmanObserver)
        and isinstance(estimator, InnovationLoad)
        and plain
    ):
        raise ParameterError("the hand-written steps know PD+FC+LE on a drive without limit, delay or effects alone")
    gains, forward, q = controller.tracking.gains, controller.tracking.feedforward or Feedforward(0.0), observer.tuning
    return LaneParameters(
        _machine(drive.plant, drive.friction),
        _machine(observer.plant, observer.friction),
        float(drive.sensor.resolution or 0.0),
        [float(gains.kp), float(gains.kd), float(forward.mass), *_pair(forward.damping)],
        [
            float(q.position), float(q.velocity), float(q.bristle), float(q.measurement), float(estimator.gain),
            float(estimator.min_speed), -np.inf if estimator.floor is None else float(estimator.floor),
        ],
        load_amplitude,
    ).numbers  # fmt: skip
