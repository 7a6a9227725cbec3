"""PD+FC and PD+FC+LE: the friction observer's estimate added to the command."""

from typing import Any, NamedTuple

from diffdrive.controllers.base import Command, Controller, LastError, Reference, Tracking
from diffdrive.model.parameters import Scalar
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

    def init(self, position: Scalar) -> FrictionCompensationState:
        return FrictionCompensationState(LastError.none(), self.observer.init(position))

    def step(
        self, state: FrictionCompensationState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[FrictionCompensationState, Command]:
        observed, estimate = self.observer.step(state.observer, applied, position, period)
        last_error, force = self.tracking.step(state.last_error, reference, position, period)
        return FrictionCompensationState(last_error, observed), Command(force + estimate.friction, estimate)
