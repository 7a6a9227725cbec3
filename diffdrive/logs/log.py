"""A log: the signals of one motion, simulated or measured, in SI units on a uniform clock."""

import dataclasses
import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from diffdrive.errors import LogError
from diffdrive.support.messages import short_repr, suggestion

Signal = Float[np.ndarray, " n"]
Samples = Float[np.ndarray, " m"]  # of another length than the signals beside it


class Channel(NamedTuple):
    """One signal that a log may hold: its SI unit and what it is."""

    unit: str
    meaning: str
    required: bool = False


CHANNELS = {
    "time": Channel("s", "time of the sample", required=True),
    "reference": Channel("m", "where the table should be"),
    "position": Channel("m", "measured position: of the table, or of the motor as table travel", required=True),
    "command": Channel(
        "N", "force or torque set-point before the current loop, computed at this sample", required=True
    ),
    "motor_position": Channel("m", "motor encoder beside a scale, as table travel (motor turns times lead)"),
    "load": Channel("N", "applied load on the guides"),
    "disturbance": Channel("N", "known force on the table beside the actuator's, such as test pulses"),
    "velocity": Channel("m/s", "velocity as the machine reports it"),
    "current": Channel("A", "measured motor current"),
    "temperature": Channel("degC", "temperature"),
}
# what a file may hold, beyond what becomes a signal of the log
READABLE = CHANNELS | {
    "injected": Channel("N", "known force added to the controller's output and part of the command: a disturbance"),
}


@dataclass(frozen=True, repr=False, eq=False)
class Log:
    """Signals of one motion; arrays of shape [n], None where the log has no such signal.

    `gaps` are the indices k at which samples are missing between k - 1 and k; `notes` say what a reader repaired;
    `shifts` are the samples by which it shifted channels, as its mapping says.

    Raises `LogError`, which names the channel, where signals are no real numbers of one length, or gaps lie outside.
    """

    name: str
    time: Signal
    position: Signal
    command: Signal
    reference: Signal | None = None
    motor_position: Signal | None = None
    load: Signal | None = None
    disturbance: Signal | None = None
    velocity: Signal | None = None
    current: Signal | None = None
    temperature: Signal | None = None
    gaps: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()
    shifts: Mapping[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, channel in CHANNELS.items():
            values = getattr(self, name)
            if values is not None:
                object.__setattr__(self, name, self._as_signal(name, values))
            elif channel.required:
                required = ", ".join(name for name, channel in CHANNELS.items() if channel.required)
                raise LogError(f"{self.name}: {name}: is missing; a log has {required}")
        count = len(self.time)
        if count < 2:
            raise LogError(f"{self.name}: time: has {count} samples, and a log at least 2")
        for name, signal in self.channels.items():
            if len(signal) != count:
                raise LogError(
                    f"{self.name}: {name}: has {len(signal)} samples, time {count}: read both from the same rows"
                )
        object.__setattr__(self, "gaps", tuple(self.gaps))
        for place in self.gaps:
            if not isinstance(place, int | np.integer) or not 0 < place < count:
                raise LogError(f"{self.name}: gaps: {place!r} is no place between two of {count} samples")
        if any(later <= earlier for earlier, later in itertools.pairwise(self.gaps)):
            raise LogError(f"{self.name}: gaps: must rise, got {short_repr(self.gaps)}")
        for name in self.shifts:
            if name not in READABLE:
                raise LogError(f"{self.name}: shifts: no such channel '{name}'; {suggestion(name, READABLE)}")

    def _as_signal(self, name: str, values: ArrayLike) -> Signal:
        signal = np.asarray(values)
        if signal.ndim != 1:
            raise LogError(f"{self.name}: {name}: has {signal.ndim} dimensions; a signal is one number in each row")
        if signal.dtype.kind not in "fiu":
            raise LogError(f"{self.name}: {name}: holds {signal.dtype}; a signal is one real number in each row")
        return signal.astype(np.float64, copy=False)

    def __repr__(self) -> str:
        low, high = 1e3 * float(np.min(self.position)), 1e3 * float(np.max(self.position))
        speed = 1e3 * float(np.max(np.abs(np.diff(self.position)))) * self.rate
        gaps = f", {len(self.gaps)} gaps" if self.gaps else ""
        return (
            f"Log '{self.name}': {len(self.time)} samples at {self.rate:.6g} Hz, {low:.4g} to {high:.4g} mm, "
            f"up to {speed:.3g} mm/s{gaps}; {', '.join(self.channels)}"
        )

    def replace(self, **signals: Signal | None) -> "Log":
        """The log with other signals, by channel: arrays of the same length, or None for none.

        Raises `LogError` for a field that no log has, and for signals that make no log.
        """
        known = [field.name for field in fields(self)]
        for name in signals:
            if name not in known:
                raise LogError(f"{self.name}: no such field '{name}'; {suggestion(name, known)}")
        return dataclasses.replace(self, **signals)  # type: ignore[arg-type]  # mypy asks for a type that fits every field

    @property
    def rate(self) -> float:
        """Samples per second, over the longest stretch without a gap."""
        longest = max(self.pieces(), key=lambda piece: piece.stop - piece.start)
        time = self.time[longest]
        return float((len(time) - 1) / (time[-1] - time[0]))

    @property
    def duration(self) -> float:
        """Seconds from the first to the last sample."""
        return float(self.time[-1] - self.time[0])

    @property
    def channels(self) -> dict[str, Signal]:
        """The signals that the log holds, by name, in the order of `CHANNELS`."""
        held = {field.name for field in fields(self)}
        return {name: getattr(self, name) for name in CHANNELS if name in held and getattr(self, name) is not None}

    def pieces(self) -> list[slice]:
        """The stretches without a gap, in order."""
        edges = [0, *self.gaps, len(self.time)]
        return [slice(a, b) for a, b in itertools.pairwise(edges)]
