"""The motion that the scale shows for certain: how fast the table moves where noise cannot make it seem to."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

SLOWEST = 2e-4  # m/s, below which the table is at rest
LARGEST = 99.5  # percentile: the largest speed
WINDOWS = (5e-3, 5e-2, 0.5)  # s, windows of the velocity: the longer, the slower a motion stands out from noise
CLEARLY = 2.0  # times what noise alone may seem to move at, that the fastest of the motion is: the noise is in it, too
SLOW = 0.1  # of the 95th percentile of speed, which counts as motion where that is slow throughout
CHATTER = 4.0  # standard deviations of the measured velocity, below which nothing says that the table moves


class ExcitationDeficit(NamedTuple):
    """Something that the logs do not determine, why, and the motion that would."""

    what: str
    why: str
    motion: str
    hopeless: bool = False  # nothing can be determined at all

    @property
    def sentence(self) -> str:
        """All of it."""
        return f"these logs do not determine {self.what}: {self.why}; add {self.motion}"


def shown_velocity(
    position: Float[np.ndarray, "lanes n"], counts: Bool[np.ndarray, "lanes n"], noise: float, rate: float
) -> tuple[int, Float[np.ndarray, "lanes m"], float]:
    """Over how many samples the velocity is differenced, the velocity, and above which speed the table moves (m/s).

    The shortest window over which any motion stands out from the noise; where none does, the first.
    """
    found = []
    for window in WINDOWS:
        few = max(1, round(window * rate))
        velocity = (position[:, few:] - position[:, :-few]) * rate / few
        speed = np.abs(velocity[counts[:, few:]])
        if not speed.size:
            break
        seen = CHATTER * np.sqrt(2.0) * noise * rate / few  # a scale that dithers at rest does not move
        fast, fastest = np.percentile(speed, [95, LARGEST])
        found.append((few, velocity, float(max(min(SLOWEST, SLOW * fast), seen))))
        if fastest > CLEARLY * seen:
            return found[-1]
    return found[0]
