"""Relaxation of a bristle: dz/dt = v - r z at frozen velocity v has z = v / r + (z0 - v / r) exp(-r t).

Over any time the exponential itself (`decay`), x = r t. Over a short step fractions of one polynomial (`relaxation`),

    exp(-x) = 1 / (1 + x + x^2 / 2 + x^3 / 6 + x^4 / 24)   to x^5 / 120,

and its running means follow from it as from the exponential itself, m1 = (1 - e) / x, m2 = (1 - m1) / x. The bristle
then ends at z = v / r, as with the exponential, however long the step. All coefficients are positive, so that nothing
cancels and no case is distinguished, from stick to traverse. A step of
20 us has x = 0.08 at 10 mm/s; the exponential costs three times as much, and each lane waits for it
(docs/evidence/performance.md).
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.exponential import exp_neg_parts
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import homogeneous, polynomial

_MEAN = (1.0, 1 / 2, 1 / 6, 1 / 24)  # (1 - e) / x, and (1 - m1) / x, over the polynomial
_MEAN_OF_MEAN = (1 / 2, 1 / 3, 1 / 8, 1 / 24)

# of (1 - exp(-x)) / x, the slope, as a series: eight terms leave 1e-16 at x = NEAR
_SLOPE = tuple((n + 1) * (-1) ** (n + 1) / math.factorial(n + 2) for n in range(8))
SERIES_LIMIT = 0.05


class Relaxation(NamedTuple):
    """Numerators of shares over `common_denominator`, at x = numerator / denominator."""

    common_denominator: Scalar
    remaining: Scalar  # exp(-x)
    released: Scalar  # 1 - exp(-x)
    mean: Scalar  # (1 - exp(-x)) / x
    mean_of_mean: Scalar  # (1 - mean) / x


def relaxation(numerator: Scalar, denominator: Scalar) -> Relaxation:
    """`Relaxation` at x = numerator / denominator >= 0, denominator > 0; any order of derivative.

    A denominator of zero or less gives plausible but wrong numbers: guard it first (`friction.nan_unless_positive`).
    """
    mean = once(homogeneous(_MEAN, numerator, denominator))
    square = denominator * denominator
    remaining, released = square * square, numerator * mean
    return Relaxation(
        remaining + released,
        remaining,
        released,
        denominator * mean,
        denominator * homogeneous(_MEAN_OF_MEAN, numerator, denominator),
    )


class Decay(NamedTuple):
    """exp(-x) and its running mean."""

    remaining: Scalar  # exp(-x)
    mean: Scalar  # (1 - exp(-x)) / x


@jax.custom_jvp
def decay(x: Scalar) -> Decay:
    """`Decay` at x >= 0, exact to rounding from x = 0 (stick) to any x (traverse); any order of derivative."""
    remaining, small, series = exp_neg_parts(x)
    return Decay(remaining, jnp.where(small, 1.0 - x * series, (1.0 - remaining) / jnp.where(small, 1.0, x)))


@decay.defjvp
def _decay_jvp(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Decay, Decay]:
    """In closed form, since a tangent through the series would cost as much as the series itself."""
    (x,), (tangent,) = primals, tangents
    value, small = decay(x), x < SERIES_LIMIT
    far = (value.remaining - value.mean) / jnp.where(small, 1.0, x)
    slope = jnp.where(small, polynomial(_SLOPE, jnp.where(small, x, 0.0)), far)
    return value, Decay(-value.remaining * tangent, slope * tangent)
