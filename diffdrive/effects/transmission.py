"""What transmits the motor's force: an elastic screw, and one with a dead zone (`two_mass`)."""

import abc
from typing import ClassVar

import numpy as np
from jaxtyping import PyTree

from diffdrive.effects.base import Acts, Envelope, Seen, StepOrder, TableEffect
from diffdrive.effects.forces import too_many_turns
from diffdrive.effects.two_mass import (
    MotorState,
    Screw,
    Sensitivity,
    step_screw,
    step_screw_with_sensitivities,
    substeps_of,
)
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantity
from diffdrive.numerics.arrays import Scalar


class Transmission(TableEffect):
    """Between motor and table, where it transmits the motor's force."""

    exclusive: ClassVar[str | None] = "screw"
    order: ClassVar[StepOrder] = StepOrder.TRANSMISSION

    @property
    @abc.abstractmethod
    def screw(self) -> Screw:
        """What connects them."""

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A resonance of so many turns in a substep that its phase is lost in rounding."""
        if envelope.period is None:
            return None
        substep = envelope.period / substeps_of(envelope.period)
        return too_many_turns(np.asarray(self.screw.frequency) * substep, "a substep")

    def substeps(self, period: float) -> int:
        """Substeps of motor and table."""
        return substeps_of(period)

    def init(self) -> PyTree:
        """The screw relaxed, in the middle of any dead zone."""
        return MotorState.at_rest()

    def motor_deflection(self, state: PyTree) -> Scalar:
        """That of the screw."""
        deflection: Scalar = state.relative.deflection
        return deflection

    def step(self, state: PyTree, seen: Seen, drive: Drive, period: float) -> tuple[PyTree, Acts]:
        """Free within a dead zone, an oscillator in contact, which lasts as long as it pushes."""
        return step_screw(self.screw, state, seen, drive, period)

    def step_with_sensitivities(
        self, state: PyTree, seen: Seen, drive: Drive, period: float
    ) -> tuple[PyTree, Acts, tuple[Sensitivity, ...]]:
        """`step`, and its sensitivities to the table's velocity and bristle, the motor's deflection and its rate."""
        return step_screw_with_sensitivities(self.screw, state, seen, drive, period)


class Compliance(Transmission):
    """An elastic screw: motor and table oscillate against each other. Neutral: an infinite frequency."""

    name: ClassVar[str] = "compliance"
    frequency: Scalar = quantity("Hz", "free resonance of motor against table", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio", at_least=0.0, below=1.0, default=0.03)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    @property
    def screw(self) -> Screw:
        """No dead zone."""
        return Screw(None, self.frequency, self.damping, self.motor_share, self.table_friction)


class Backlash(Transmission):
    """A dead zone between motor and table, behind an elastic screw.

    At a gap of zero the screw is always in contact, and the derivative by the gap is that of a screw in contact.
    """

    name: ClassVar[str] = "backlash"
    gap: Scalar = quantity("m", "backlash width: full width of the dead zone", at_least=0.0, default=0.0)
    frequency: Scalar = quantity("Hz", "free resonance of motor against table in contact", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio in contact", at_least=0.0, below=1.0, default=0.08)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    @property
    def screw(self) -> Screw:
        """With its dead zone."""
        return Screw(self.gap, self.frequency, self.damping, self.motor_share, self.table_friction)
