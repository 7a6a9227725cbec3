"""PD+FC and PD+FC+LE: the friction observer's estimate added to the command."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from diffdrive.controllers.base import (
    FILTER_FACTOR,
    TRACKING_GAINS,
    Command,
    Controller,
    LastError,
    Reference,
    Tracking,
    Tunable,
)
from diffdrive.model.parameters import Drive, Scalar
from diffdrive.observers.friction_observer import FrictionObserver


class FrictionCompensationState(NamedTuple):
    """Last error and the observer's own state."""

    last_error: LastError
    observer: Any


class FrictionCompensation(Controller):
    """u = PD + feed-forward + Fhat (paper, Fig. 6(d) and (e)).

    The observer decides which of the paper's controllers this is: `KalmanObserver` with `FixedLoad` is PD+FC, with
    `InnovationLoad` PD+FC+LE as printed; `LoadStateObserver` estimates the load at every speed.
    """

    tracking: Tracking
    observer: FrictionObserver

    @property
    def kind(self) -> str:
        return f"pd+fc{self.observer.suffix}"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        observed = {name: Tunable(f"observer.{path}", FILTER_FACTOR) for name, path in self.observer.gains.items()}
        return TRACKING_GAINS | observed

    def remodelled(self, drive: Drive) -> "FrictionCompensation":
        observer = replace(self.observer, plant=drive.plant, friction=drive.friction)
        return FrictionCompensation(self.tracking.remodelled(drive.plant), observer)

    def init(self, position: Scalar) -> FrictionCompensationState:
        return FrictionCompensationState(LastError.none(), self.observer.init(position))

    def step(
        self, state: FrictionCompensationState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[FrictionCompensationState, Command]:
        observed, estimate = self.observer.step(state.observer, applied, position, period)
        last_error, force = self.tracking.step(state.last_error, reference, position, period)
        return FrictionCompensationState(last_error, observed), Command(force + estimate.friction, estimate)
