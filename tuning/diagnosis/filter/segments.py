"""Long logs cut into segments side by side, each with a lead in which its filter settles.

A filter is a loop over the samples of one log, and a processor adds eight numbers as fast as one: a filter for each
second of the log costs little more than one for its first second.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Float, Int

LENGTH, LEAD = 0.5, 0.1  # s that count, at least, and s before them
MOST = 16


class Segments(NamedTuple):
    """Which samples of a log each segment has, and where each sample of the log is found in them."""

    samples: Int[np.ndarray, "s m"]
    segment: Int[np.ndarray, " n"]
    place: Int[np.ndarray, " n"]

    def cut(self, signal: Float[Array, " n"]) -> Float[Array, "s m"]:
        """A signal of the log, segment by segment."""
        return signal[self.samples]

    def joined(self, signal: Float[Array, "s m"]) -> Float[Array, " n"]:
        """A signal of the log from that of its segments, without their leads."""
        return signal[self.segment, self.place]


def segments(count: int, rate: float) -> Segments:
    """Of a log of `count` samples."""
    pieces = int(np.clip(count / (LENGTH * rate), 1, MOST))
    length = -(-count // pieces)
    lead = min(round(LEAD * rate), length) * (pieces > 1)
    wide = min(length + lead, count)
    begins = np.clip(np.arange(pieces) * length - lead, 0, count - wide)
    sample = np.arange(count)
    segment = sample // length
    return Segments(begins[:, None] + np.arange(wide), segment, sample - begins[segment])
