"""The whole numbers of a cascade: samples of its velocity, of the delay and of the cycle of its position loop."""

from typing import NamedTuple

from diffdrive.controllers.kinds import Option
from diffdrive.support.messages import short_repr


class Count(NamedTuple):
    """A whole number of samples, which is its least where a file does not state it."""

    least: int
    meaning: str

    def problem(self, samples: object) -> str | None:
        """Why there cannot be so many samples; None where there can."""
        if isinstance(samples, bool) or not isinstance(samples, int) or samples < self.least:
            return f"must be a whole number of at least {self.least}, got {short_repr(samples)}"
        return None


POSITION_LOOP_COUNTS = {
    "reference_delay_samples": Count(0, "samples by which the position loop's set-point is delayed"),
    "position_every": Count(1, "samples in a cycle of the position loop, over which its output is held"),
}
COUNTS = {"velocity_samples": Count(1, "samples over which the velocity is differenced")} | POSITION_LOOP_COUNTS
COUNT_OPTIONS = tuple(
    Option(name, "-", f">= {count.least}, whole", f"{count.least}", count.meaning) for name, count in COUNTS.items()
)
