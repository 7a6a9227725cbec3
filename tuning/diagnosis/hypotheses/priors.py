"""What a parameter is expected to be.

Its prior is normal in its own value, in its logarithm or, where it is a share, in its log-odds. Middle and spread are
what a servo engineer would expect before seeing any log, and they are the price of a hypothesis: one that must be tuned
finely to fit pays for it in its evidence. Parameters of the session (phases, times) differ from log to log.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logit


class Scale(NamedTuple):
    """What of a value is normal."""

    of: Callable[[float], float]
    back: Callable[[float], float]
    slope: Callable[[float], float]  # of the value, by that


ITSELF = Scale(lambda value: value, lambda value: value, lambda value: 1.0)
LOGARITHM = Scale(np.log, np.exp, lambda value: value)
LOG_ODDS = Scale(logit, expit, lambda value: value * (1.0 - value))


class Parameter(NamedTuple):
    """A free parameter of an effect and its prior."""

    name: str
    middle: float
    spread: float  # standard deviation, on its scale
    scale: Scale = ITSELF
    session: bool = False
    amplitude: bool = False  # the effect is linear in it and gone where it is zero

    def value(self, theta: float) -> float:
        """At `theta` standard deviations from the middle."""
        return float(self.scale.back(self.scale.of(self.middle) + theta * self.spread))

    def standard(self, value: float) -> float:
        """The inverse."""
        return float((self.scale.of(value) - self.scale.of(self.middle)) / self.spread)

    def slope(self, theta: float) -> float:
        """Of the value, by theta."""
        return self.spread * self.scale.slope(self.value(theta))
