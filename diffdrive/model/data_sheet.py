"""What the data sheets of an axis say: its kind, its screw or gear, its motor, its encoder and its scale.

Nothing of it is simulated. It says what the motor's units are at the table (`motor_units`), and states what effects
would otherwise state again.
"""

import math
from typing import cast

import equinox as eqx

from diffdrive.errors import ParameterError
from diffdrive.model.quantity import check, quantity
from diffdrive.support.messages import short_repr

KINDS = ("linear", "rotary")


class DataSheet(eqx.Module):
    """The numbers on the data sheets of an axis, all optional, in SI units.

    A linear axis has a screw, a rack or a belt: `lead` is the travel in one turn of what the gear drives. A rotary axis
    has a table that turns: its positions are in rad, its forces are torques in N m, its mass is an inertia in kg m^2.
    A screw's efficiency is not here: what it loses is friction, which the drive states for itself.

    Raises `ParameterError` for a number out of its range, and for one that no such axis has.

    Examples:
        >>> sheet = DataSheet(lead=10e-3, rated_torque=5.0)
        >>> sheet.travel_per_radian, sheet.rated_force

    """

    kind: str = eqx.field(static=True, default="linear")
    lead: float | None = quantity("m", "travel per turn of the screw", above=0.0, default=None)
    gear_ratio: float = quantity("1", "turns of the motor per turn of the screw or table", above=0.0, default=1.0)
    motor_inertia: float | None = quantity("kg*m^2", "inertia of the motor's rotor", above=0.0, default=None)
    rated_torque: float | None = quantity("N*m", "rated torque of the motor: 100 %", above=0.0, default=None)
    rated_current: float | None = quantity("A", "rated current of the motor", above=0.0, default=None)
    torque_constant: float | None = quantity(
        "N*m/A", "torque per current; absent: rated torque over rated current", above=0.0, default=None
    )
    encoder_counts: float | None = quantity(
        "1", "counts of the motor's encoder per turn of the motor, as the control counts them", above=0.0, default=None
    )
    scale_period: float | None = quantity("m", "signal period of the scale", above=0.0, default=None)

    def __check_init__(self) -> None:
        if self.kind not in KINDS:
            raise ParameterError(f"axis.kind: must be one of {', '.join(KINDS)}, got {short_repr(self.kind)}")
        check(self, "axis")
        if self.kind == "rotary" and self.lead is not None:
            raise ParameterError(
                "axis.lead: a rotary axis has none: state gear_ratio, the motor's turns per table turn"
            )

    @property
    def is_rotary(self) -> bool:
        """Whether the table turns."""
        return self.kind == "rotary"

    @property
    def is_empty(self) -> bool:
        """Whether it says nothing."""
        return self == NO_SHEET

    @property
    def travel_per_radian(self) -> float | None:
        """How far the table moves (m; rad of a rotary one) while the motor turns by 1 rad."""
        if self.is_rotary:
            return 1.0 / self.gear_ratio
        return None if self.lead is None else self.lead / (2.0 * math.pi * self.gear_ratio)

    @property
    def torque_per_ampere(self) -> float | None:
        """The motor's torque per current (N m/A)."""
        if self.torque_constant is not None or self.rated_torque is None or self.rated_current is None:
            return self.torque_constant
        return self.rated_torque / self.rated_current

    @property
    def rated_force(self) -> float | None:
        """The force on the table (N; N m of a rotary one) at the motor's rated torque."""
        if self.rated_torque is None or self.travel_per_radian is None:
            return None
        return self.rated_torque / self.travel_per_radian

    @property
    def rotor_mass(self) -> float | None:
        """The moving mass (kg; kg m^2 of a rotary axis) that the motor's rotor is at the table."""
        if self.motor_inertia is None or self.travel_per_radian is None:
            return None
        return self.motor_inertia / self.travel_per_radian**2

    def __eq__(self, other: object) -> bool:
        return isinstance(other, DataSheet) and self._values() == other._values()

    def __hash__(self) -> int:  # so that an axis can be a static argument of compiled functions
        return hash(self._values())

    def _values(self) -> tuple[object, ...]:
        return cast(tuple[object, ...], tuple(getattr(self, name) for name in self.__dataclass_fields__))


NO_SHEET = DataSheet()  # which says nothing
