"""PD: feedback and motion feed-forward alone."""

from collections.abc import Mapping

from diffdrive.controllers.base import TRACKING_GAINS, Command, Controller, LastError, Reference, Tracking, Tunable
from diffdrive.model.parameters import Drive, Scalar


class PD(Controller):
    """Proportional-derivative position control (paper, Fig. 6(a))."""

    tracking: Tracking

    @property
    def kind(self) -> str:
        return "pd"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        return TRACKING_GAINS

    def remodelled(self, drive: Drive) -> "PD":
        return PD(self.tracking.remodelled(drive.plant))

    def init(self, position: Scalar) -> LastError:
        return LastError.none()

    def step(
        self, state: LastError, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[LastError, Command]:
        state, force = self.tracking.step(state, reference, position, period)
        return state, Command(force)
