"""PD: feedback and motion feed-forward alone."""

from diffdrive.controllers.base import Command, Controller, LastError, Reference, Tracking
from diffdrive.model.parameters import Scalar


class PD(Controller):
    """Proportional-derivative position control (paper, Fig. 6(a))."""

    tracking: Tracking

    def init(self, position: Scalar) -> LastError:
        return LastError.none()

    def step(
        self, state: LastError, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[LastError, Command]:
        state, force = self.tracking.step(state, reference, position, period)
        return state, Command(force)
