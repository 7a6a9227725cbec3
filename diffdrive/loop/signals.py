"""The signals of a simulated motion, which a run and a roll-out share."""

import abc
from typing import Generic, TypeVar

import equinox as eqx
import numpy as np
from jaxtyping import Array

from diffdrive.loop.metrics import window

Signal = TypeVar("Signal", np.ndarray, Array)


class Signals(eqx.Module, Generic[Signal]):
    """One simulated motion: signals of shape [n]. Estimates are None where the controller makes none."""

    reference: Signal  # m
    load: Signal  # N
    measured: Signal  # m, position as the scale reports it
    table_position: Signal  # m, true
    velocity: Signal  # m/s, true
    command: Signal  # N, before the actuator
    force: Signal  # N, after it
    friction: Signal  # N, without the damping B_S v
    friction_estimate: Signal | None  # N
    load_estimate: Signal | None  # N
    motor_position: Signal | None = eqx.field(default=None, kw_only=True)  # m, as the motor encoder reports it

    @property
    def error(self) -> Signal:
        """Tracking error of the table, reference minus true position (m)."""
        return self.reference - self.table_position

    @property
    def position(self) -> Signal:
        """`measured`, by the name that a log has for it (m)."""
        return self.measured

    @abc.abstractmethod
    def sample_times(self) -> np.ndarray:
        """The time of each sample, as in the motion (s)."""

    def between(self, start: float, end: float) -> slice:
        """The samples in [start, end] (s), none of them traced; raises `ParameterError` if there is none."""
        return window(self.sample_times(), start, end)
