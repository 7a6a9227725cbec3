"""What a bristle forgets over a short step, as fractions of one polynomial.

    exp(-x) = 1 / (1 + x + x^2 / 2 + x^3 / 6 + x^4 / 24)   to x^5 / 120,

and its running means follow from it as they follow from the exponential itself, m1 = (1 - e) / x, m2 = (1 - m1) / x:
what stays and what a motion draws then end where dz/dt = v - r z ends, at z = v / r, however long the step. All
coefficients are positive, so that nothing cancels and nothing has to be told apart, from stick to traverse. A step of
25 us has x = 0.1 at 10 mm/s; the exponential costs three times as much, and each lane waits for it
(docs/performance.md).
"""

from typing import NamedTuple

from jax import lax

from diffdrive.parameters import Scalar
from diffdrive.polynomial import homogeneous

_MEAN = (1.0, 1 / 2, 1 / 6, 1 / 24)  # (1 - e) / x, and (1 - m1) / x, over the polynomial
_MEAN_OF_MEAN = (1 / 2, 1 / 3, 1 / 8, 1 / 24)


class Relaxation(NamedTuple):
    """Shares of `whole`, of which they are the numerators; x = top / bottom."""

    whole: Scalar
    end: Scalar  # exp(-x)
    gone: Scalar  # 1 - exp(-x)
    mean: Scalar  # (1 - exp(-x)) / x
    mean_of_mean: Scalar  # (1 - mean) / x


def relaxation(top: Scalar, bottom: Scalar) -> Relaxation:
    """`Relaxation` at x = top / bottom, where top >= 0 and bottom > 0; any order of derivative."""
    mean = lax.optimization_barrier(homogeneous(_MEAN, top, bottom))
    square = bottom * bottom
    end, gone = square * square, top * mean
    return Relaxation(end + gone, end, gone, bottom * mean, bottom * homogeneous(_MEAN_OF_MEAN, top, bottom))
