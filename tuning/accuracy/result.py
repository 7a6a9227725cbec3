"""What a simulated acceptance test says of an axis, with and without its unmodelled effects."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.results import Result, Status

AS_IT_IS, SOUND = "none", "all"  # of the effects is mended
NEGLIGIBLE, SHOWN = 0.01, 1e-9  # of A or G, whichever is larger, and m: what costs less than either is not named first
JUDGED = ("accuracy", "circular_deviation")  # what a tolerance is for: acceptance tests limit these two
TERMS: Mapping[str, str] = {
    "accuracy": "positioning accuracy A",
    "systematic": "systematic deviation E",
    "repeatability": "repeatability R",
    "reversal_error": "reversal error B",
    "circular_deviation": "circular deviation G",
    "hysteresis": "circular hysteresis H",
}


class Accuracy(NamedTuple):
    """ISO 230-2 and 230-4 of a machine, in m (rad of a rotary axis, which draws no circle)."""

    accuracy: float
    systematic: float
    repeatability: float
    reversal_error: float
    circular_deviation: float | None
    hysteresis: float | None

    def judged(self) -> dict[str, float]:
        """What a tolerance is for."""
        return {name: value for name in JUDGED if (value := getattr(self, name)) is not None}


class Without(NamedTuple):
    """A machine without one of its effects, or without `SOUND`."""

    effect: str
    parts: tuple[str, ...]  # of the machine, that are mended then
    accuracy: Accuracy


@dataclass(frozen=True, repr=False, eq=False)
class SeverityResult(Result):
    """The accuracy of an axis as it is, and what it would be without each effect, and without any.

    SI units: m, or rad of a rotary axis.
    """

    as_it_is: Accuracy
    without: tuple[Without, ...]  # each effect of the axis in turn, then all
    tolerance: float | None
    is_rotary: bool
    stroke: tuple[float, float]  # of the tests
    status: Status
    notes: tuple[str, ...]
    # of each machine, by what is mended: the deviation of the radius at even angles, counter-clockwise and clockwise
    circles: Mapping[str, Float[np.ndarray, "2 t"]] = field(default_factory=dict)

    schema: ClassVar[str] = "severity/1"

    @property
    def sound(self) -> Accuracy:
        """Without any of the effects."""
        return self.without[-1].accuracy

    @property
    def by_gain(self) -> list[Without]:
        """The effects, the one first whose mending gains most of A or G."""
        return sorted(self.without[:-1], key=lambda one: -self.gain(one))

    @property
    def first(self) -> Without | None:
        """What to mend first; None where no single mending gains a hundredth of A or G, or 1 nm."""
        best = self.by_gain[0]
        return best if self.gain(best) > max(SHOWN, NEGLIGIBLE * max(self.as_it_is.judged().values())) else None

    @property
    def beyond(self) -> tuple[str, ...]:
        """What is beyond the tolerance."""
        if self.tolerance is None:
            return ()
        return tuple(TERMS[name] for name, value in self.as_it_is.judged().items() if value > self.tolerance)

    def gain(self, one: Without) -> float:
        """By how much A or G, whichever gains more, falls with the effect mended (m)."""
        mended = one.accuracy.judged()
        return max(value - mended[name] for name, value in self.as_it_is.judged().items())

    @property
    def unit(self) -> tuple[str, float]:
        """In which lengths (or angles) are shown, and how many of it make the SI unit."""
        return ("µrad" if self.is_rotary else "µm"), 1e6

    def headline(self) -> str:
        unit, factor = self.unit
        now = ", ".join(
            f"{TERMS[name]} {factor * value:.3g} {unit} ({factor * self.sound.judged()[name]:.3g} {unit} if sound)"
            for name, value in self.as_it_is.judged().items()
        )
        if self.tolerance is None:
            return now
        limit = f"{factor * self.tolerance:.3g} {unit}"
        return f"{now}; " + (f"beyond {limit}: {' and '.join(self.beyond)}" if self.beyond else f"within {limit}")

    def summary(self) -> str:
        unit, factor = self.unit
        lines = [self.headline()]
        for one in self.by_gain:
            now = ", ".join(
                f"{TERMS[name][-1]} {factor * value:.3g} {unit}" for name, value in one.accuracy.judged().items()
            )
            lines.append(f"- without {one.effect} ({', '.join(one.parts)}): {now}")
        if self.first is None:
            lines.append("No single effect costs accuracy at rest or on a circle.")
        else:
            lines.append(f"Look at the {self.first.parts[0]} first: {self.first.effect} costs most.")
        return "\n".join([*lines, *self.notes])

    def as_dict(self) -> dict[str, object]:
        return {
            "as_it_is_m": self.as_it_is._asdict(),
            "without": [
                {"effect": one.effect, "parts": list(one.parts), "accuracy_m": one.accuracy._asdict()}
                for one in self.without
            ],
            "first": None if self.first is None else self.first.effect,
            "tolerance_m": self.tolerance,
            "beyond_tolerance": list(self.beyond),
            "stroke_m": list(self.stroke),
        }
