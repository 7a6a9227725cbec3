"""PD: feedback and motion feed-forward alone."""

from collections.abc import Mapping

from diffdrive.controllers.base import (
    TRACKING_GAINS,
    Command,
    Controller,
    LastError,
    Reference,
    Tracking,
    Tunable,
    paper_tracking,
)
from diffdrive.controllers.kinds import DERIVATIVE, FEEDFORWARD, TRACKING_KEYS, Kind, read_tracking
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.typing import TomlTable


class PD(Controller):
    """Proportional-derivative position control (paper, Fig. 6(a))."""

    tracking: Tracking

    @property
    def kind(self) -> str:
        return "pd"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        return TRACKING_GAINS

    @property
    def has_friction_observer(self) -> bool:
        return False

    @property
    def is_linear(self) -> bool:
        return True

    @property
    def is_memoryless(self) -> bool:
        return True

    def table(self) -> TomlTable:
        return self.tracking.table()

    def with_model(self, drive: Drive) -> "PD":
        return PD(self.tracking.with_model(drive.plant))

    def init(self, position: Scalar) -> LastError:
        return LastError.none()

    def step(
        self, state: LastError, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[LastError, Command]:
        state, force = self.tracking.step(state, reference, position, period)
        return state, Command(force)


KIND = Kind(
    "pd",
    "feedback and motion feed-forward",
    # a bare PD is what many machines run, and has no feed-forward unless the file says so
    lambda section, drive: PD(read_tracking(section, drive, feedforward=False)),
    (TRACKING_KEYS,),
    (FEEDFORWARD, DERIVATIVE),
    example=lambda drive: PD(paper_tracking(drive)),
)
