"""What motor minus table says of an axis: the result of `compare_encoders`."""

from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from diffdrive.logs.encoders.regression import Estimate
from diffdrive.results import Result, Status

OK = Status(True)

# what differs in proportion to the speed has two causes, which a log does not tell apart
READ_EARLIER = "{} ms times the speed: the table is read earlier than the motor, or viscous friction winds the screw up"


class Reversal(NamedTuple):
    """One reversal and its lost motion."""

    time: float  # s
    position: float  # m
    error: float  # m


class Place(NamedTuple):
    """A stretch of the stroke: motor minus table forwards against backwards."""

    low: float  # m
    high: float  # m
    error: Estimate  # m


class ComparedSamples(NamedTuple):
    """The samples that were looked at; [n] each, in SI units."""

    rows: Int[np.ndarray, " n"]  # index into the log
    time: Float[np.ndarray, " n"]
    position: Float[np.ndarray, " n"]
    difference: Float[np.ndarray, " n"]  # motor minus table, about its mean
    direction: Float[np.ndarray, " n"]  # +1, -1
    fitted: Float[np.ndarray, " n"]  # the difference by the model; not a number where the table does not slide
    as_table: Float[np.ndarray, " n"]  # the motor as the table's position, with the lost motion and without the rest


@dataclass(frozen=True, repr=False, eq=False)
class EncoderComparison(Result):
    """What motor minus table says of the screw between them; None where the log does not determine it. SI units."""

    log: str
    reversal_error: Estimate | None  # m, lost motion: the motor's travel at a reversal that the table does not make
    backlash: Estimate | None  # m of it, a gap
    wind_up: Estimate | None  # m of it, the screw's under friction
    change_along_stroke: Estimate | None  # m/m, of the reversal error
    scatter: float | None  # m, standard deviation of the reversal error from reversal to reversal
    compliance: Estimate | None  # m/N, wind-up per newton of the command
    period: float | None  # m, of the error per turn: the lead, stated or found
    per_turn: Estimate | None  # m, amplitude of the error per turn
    linear: Estimate | None  # m/m, the motor's travel beyond the table's
    drift: Estimate | None  # m/s
    delay: Estimate | None  # s, by which the table was read before the motor
    residual: float  # m, standard deviation of what is left
    resolution: float  # m, step of the coarser encoder, or its noise
    reversals: tuple[Reversal, ...]
    places: tuple[Place, ...]
    samples: ComparedSamples
    status: Status = OK
    notes: tuple[str, ...] = ()

    schema: ClassVar[str] = "encoders/1"

    @property
    def has_lost_motion(self) -> bool:
        """Whether a reversal error is there, beyond its interval and what the encoders resolve."""
        error = self.reversal_error
        return error is not None and error.is_significant and error.value > self.resolution

    @property
    def has_backlash(self) -> bool:
        """Whether part of it is certainly a gap."""
        return self.has_lost_motion and self.backlash is not None and self.backlash.low > self.resolution

    @property
    def may_be_all_backlash(self) -> bool:
        """Whether nothing speaks against backlash alone, and wind-up as in acceleration makes less than half of it."""
        error, backlash = self.reversal_error, self.backlash
        if error is None or backlash is None or not self.has_lost_motion:
            return False
        return backlash.high >= error.low and backlash.value > 0.5 * error.value

    def kinematics(self) -> list[tuple[str, Estimate]]:
        """What is beyond its interval and, over the log, what the encoders resolve: in words, and in SI units."""
        samples = self.samples
        travel, seconds = float(np.ptp(samples.position)), float(np.ptp(samples.time))
        speed = float(np.max(np.abs(np.gradient(samples.position, samples.time)))) if seconds > 0.0 else 0.0
        period = 0.0 if self.period is None else 1e3 * self.period
        every = (
            ("linear error {} um/m", self.linear, 1e6, travel),
            (f"error of {{}} um either way per turn of {period:.4g} mm", self.per_turn, 1e6, 1.0),
            ("drift {} um/min", self.drift, 60e6, seconds),
            (READ_EARLIER, self.delay, 1e3, speed),
        )
        return [
            (text.format(in_words(one, factor)), one)
            for text, one, factor, span in every
            if one is not None and one.is_significant and abs(one.value) * span > self.resolution
        ]

    def headline(self) -> str:
        """The reversal error and its parts."""
        if self.reversal_error is None:
            return "no reversal error: the table does not slide in both directions"
        text = f"reversal error {in_words(self.reversal_error, 1e6)} um"
        if self.backlash is not None and self.has_lost_motion:
            text += f", backlash {in_words(self.backlash, 1e6)} um of it"
        return text

    def summary(self) -> str:
        """All that was found, a line each."""
        return "\n".join(
            [self.headline(), *(f"  {name}: {in_words(one, factor)} {unit}" for name, one, factor, unit in self.rows())]
        )

    def rows(self) -> list[tuple[str, Estimate, float, str]]:
        """Name, estimate in SI units, factor to the unit shown, and that unit, of all that is determined."""
        every = [
            ("reversal error", self.reversal_error, 1e6, "um"),
            ("backlash", self.backlash, 1e6, "um"),
            ("wind-up under friction", self.wind_up, 1e6, "um"),
            ("wind-up per newton", self.compliance, 1e9, "nm/N"),
            ("change of the reversal error along the stroke", self.change_along_stroke, 1e6, "um/m"),
            ("error per turn, amplitude", self.per_turn, 1e6, "um"),
            ("linear error", self.linear, 1e6, "um/m"),
            ("drift", self.drift, 60e6, "um/min"),
            ("table read before the motor by", self.delay, 1e3, "ms"),
        ]
        return [(name, one, factor, unit) for name, one, factor, unit in every if one is not None]

    def as_dict(self) -> dict[str, object]:
        """In SI units: value, low and high of each."""
        names = (
            ("reversal_error_m", self.reversal_error),
            ("backlash_m", self.backlash),
            ("wind_up_m", self.wind_up),
            ("compliance_m_per_N", self.compliance),
            ("change_along_stroke_m_per_m", self.change_along_stroke),
            ("per_turn_m", self.per_turn),
            ("linear_m_per_m", self.linear),
            ("drift_m_per_s", self.drift),
            ("delay_s", self.delay),
        )
        return {
            **{name: None if one is None else one._asdict() for name, one in names},
            "scatter_m": self.scatter,
            "period_m": self.period,
            "residual_m": self.residual,
            "resolution_m": self.resolution,
            "reversals": [{"time_s": t, "position_m": x, "error_m": e} for t, x, e in self.reversals],
            "places": [{"low_m": low, "high_m": high, "error_m": one._asdict()} for low, high, one in self.places],
        }


def in_words(estimate: Estimate, factor: float) -> str:
    """An estimate in another unit, such as `10.2 (9.8 to 10.6)`."""
    value, low, high = (f"{factor * one:.3g}" for one in estimate)
    return f"{value} ({low} to {high})"
