"""A measured frequency response, and what it is the response of."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Complex, Float

from diffdrive.errors import ParameterError
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.motor_units import to_axis_si
from diffdrive.support.bounds import require_a
from diffdrive.support.messages import short_repr

# what a response may be of, and what it leads from and to
RESPONSES = {
    "plant": "from the torque or force that acts to the speed, the current loop not in it",
    "plant-with-current-loop": "from the set-point of torque or force to the speed, current loop and dead time in it",
    "speed-loop": "closed, from the set-point of the speed to the speed, the position loop open",
    "position-loop": "closed, from the set-point of the position to the position",
    "open-loop": "opened at the force, under negative feedback, as `LinearLoop.response` has it",
}
PLANTS = ("plant", "plant-with-current-loop")  # which have a unit; the others are ratios
SPEED_PER_FORCE = "m/s/N"
FEWEST = 4  # points: a cubic through fewer says nothing between them


@dataclass(frozen=True, eq=False, repr=False)
class FrequencyResponse:
    """A measured frequency response: complex values [f] at frequencies [f] that rise (Hz).

    Attributes:
        frequency: Hz, above 0.
        value: In `unit`.
        of: What it is of: "plant" (from the torque or force that acts to the speed, the current loop not in it),
            "plant-with-current-loop" (from the set-point of torque or force to the speed), "speed-loop" and
            "position-loop" (closed, from set-point to actual value), "open-loop" (opened at the force, under negative
            feedback).
        unit: Of a plant, at the table or of the motor: "(m/s)/N", "(rad/s)/(N*m)". The others are ratios, "1".
        coherence: From 0 to 1, [f]; None where it is not known.
        name: Of the file.
        notes: What was done while it was read.

    Raises:
        ParameterError: A field has the wrong shape, order or range, or is not finite.

    Examples:
        >>> measured = FrequencyResponse(frequency, speed_over_force, of="plant", unit="(m/s)/N")

    """

    frequency: Float[np.ndarray, " f"]
    value: Complex[np.ndarray, " f"]
    of: str
    unit: str = "1"
    coherence: Float[np.ndarray, " f"] | None = None
    name: str = "measured"
    notes: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        require_known(self.of)
        frequency, value = np.asarray(self.frequency, float), np.asarray(self.value, complex)
        if frequency.ndim != 1 or value.shape != frequency.shape or len(frequency) < FEWEST:
            raise ParameterError(f"{self.name}: frequency and value must be arrays of one length, {FEWEST} or more")
        if not (np.all(np.isfinite(frequency)) and np.all(np.diff(frequency) > 0.0) and frequency[0] > 0.0):
            raise ParameterError(f"{self.name}: frequency: must be above 0 and rise from each value to the next")
        if not (np.all(np.isfinite(value)) and np.all(value != 0.0)):
            at = frequency[np.argmax(~np.isfinite(value) | (value == 0.0))]
            raise ParameterError(f"{self.name}: value: is zero or not finite at {at:g} Hz; leave this frequency out")
        if (self.unit == "1") != (self.of not in PLANTS):
            raise ParameterError(
                f"{self.name}: unit: a {self.of} has "
                + ("a unit: state it, such as '(rad/s)/(N*m)' or '(m/s)/N'" if self.of in PLANTS else "none: it is '1'")
            )
        object.__setattr__(self, "frequency", frequency)
        object.__setattr__(self, "value", value)
        if self.coherence is None:
            return
        coherence = np.asarray(self.coherence, float)
        if coherence.shape != frequency.shape or not np.all((coherence >= 0.0) & (coherence <= 1.0 + 1e-9)):
            raise ParameterError(f"{self.name}: coherence: must be from 0 to 1 at every frequency")
        object.__setattr__(self, "coherence", coherence)

    def at_table(self, sheet: DataSheet) -> Complex[np.ndarray, " f"]:
        """The values with a plant in m/s per N at the table (a rotary axis: rad/s per N m), by the axis's data sheet.

        Raises:
            ParameterError: The unit is none of speed per force, or the sheet says too little to read it.

        """
        if self.of not in PLANTS:
            return self.value
        text = self.unit if self.unit[:1].isdigit() else f"1 {self.unit}"
        try:
            return self.value * to_axis_si(text, SPEED_PER_FORCE, sheet)
        except ValueError as problem:
            raise ParameterError(f"{self.name}: unit: {problem}; a plant is speed per force or torque") from None

    def __repr__(self) -> str:
        low, high = self.frequency[[0, -1]]
        return f"FrequencyResponse of {self.of} in {self.unit}: {len(self.frequency)} from {low:.3g} to {high:.4g} Hz"


def require_response(measured: object, name: str = "measured") -> None:
    """Raise `ParameterError` for what is no frequency response, such as the path of its file."""
    require_a(FrequencyResponse, name, measured, "read a file with read_frequency_response")


def require_known(of: object) -> None:
    """Raise `ParameterError` unless a response can be of this."""
    if of not in RESPONSES:
        known = "; ".join(f"'{name}', {meaning}" for name, meaning in RESPONSES.items())
        raise ParameterError(f"of: say what the response is of, got {short_repr(of)}; one of {known}")
