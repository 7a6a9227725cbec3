"""What a bristle forgets: dz/dt = v - r z at frozen velocity v has z = v / r + (z0 - v / r) exp(-r t).

Over any time the exponential itself (`decay`), x = r t. Over a short step fractions of one polynomial (`relaxation`),

    exp(-x) = 1 / (1 + x + x^2 / 2 + x^3 / 6 + x^4 / 24)   to x^5 / 120,

and its running means follow from it as they follow from the exponential itself, m1 = (1 - e) / x, m2 = (1 - m1) / x:
what stays and what a motion draws then end where the exponential ends, at z = v / r, however long the step. All
coefficients are positive, so that nothing cancels and nothing has to be told apart, from stick to traverse. A step of
20 us has x = 0.08 at 10 mm/s; the exponential costs three times as much, and each lane waits for it
(docs/evidence/performance.md).
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffdrive.model.parameters import Scalar
from diffdrive.numerics.exponential import exp_neg_parts
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import homogeneous, polynomial

_MEAN = (1.0, 1 / 2, 1 / 6, 1 / 24)  # (1 - e) / x, and (1 - m1) / x, over the polynomial
_MEAN_OF_MEAN = (1 / 2, 1 / 3, 1 / 8, 1 / 24)

# of (1 - exp(-x)) / x, the slope, as a series: eight terms leave 1e-16 at x = NEAR
_SLOPE = tuple((n + 1) * (-1) ** (n + 1) / math.factorial(n + 2) for n in range(8))
NEAR = 0.05


class Relaxation(NamedTuple):
    """Shares of `whole`, of which they are the numerators; x = top / bottom."""

    common_denominator: Scalar
    end: Scalar  # exp(-x)
    gone: Scalar  # 1 - exp(-x)
    mean: Scalar  # (1 - exp(-x)) / x
    mean_of_mean: Scalar  # (1 - mean) / x


def relaxation(top: Scalar, bottom: Scalar) -> Relaxation:
    """`Relaxation` at x = top / bottom, where top >= 0 and bottom > 0; any order of derivative.

    A `bottom` that is not above zero gives numbers that look like others: guard it first
    (`friction.nan_unless_positive`).
    """
    mean = once(homogeneous(_MEAN, top, bottom))
    square = bottom * bottom
    end, gone = square * square, top * mean
    return Relaxation(end + gone, end, gone, bottom * mean, bottom * homogeneous(_MEAN_OF_MEAN, top, bottom))


class Decay(NamedTuple):
    """exp(-x) and its running mean."""

    end: Scalar  # exp(-x)
    mean: Scalar  # (1 - exp(-x)) / x


@jax.custom_jvp
def decay(x: Scalar) -> Decay:
    """`Decay` at x >= 0, exact to rounding from x = 0 (stick) to any x (traverse); any order of derivative."""
    end, small, series = exp_neg_parts(x)
    return Decay(end, jnp.where(small, 1.0 - x * series, (1.0 - end) / jnp.where(small, 1.0, x)))


@decay.defjvp
def _decay_along(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Decay, Decay]:
    """In closed form, since a tangent through the series would cost as much as the series itself."""
    (x,), (along,) = primals, tangents
    found, small = decay(x), x < NEAR
    far = (found.end - found.mean) / jnp.where(small, 1.0, x)
    slope = jnp.where(small, polynomial(_SLOPE, jnp.where(small, x, 0.0)), far)
    return found, Decay(-found.end * along, slope * along)
