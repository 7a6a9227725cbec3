"""Cosine and sine together, for waves in time and in position.

A library's do not vectorise here and cost more than the rest of a control step. The angle is reduced to within an
eighth of a turn of a multiple of a quarter turn, both series are summed, and the quarter decides which is which. A
single-precision angle gives single precision (1e-7), by the same steps with fewer terms.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jax.typing import DTypeLike

from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.polynomial import polynomial

MAX_TURNS = 1e9  # of an angle: there its rounding error is a millionth of a radian
_QUARTERS = 2.0 / math.pi
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(8))  # in r^2; what is left out is 5e-17
_COSINE = tuple((-1) ** k / math.factorial(2 * k) for k in range(9))


class _Precision(NamedTuple):
    """Constants of the argument reduction in single or double precision, and the terms of the series."""

    magic: float  # beside it a whole number stands in the last bits
    quarter: tuple[float, float, float]  # pi / 2 in parts, of so few bits that a whole multiple is exact
    terms: int
    bits: DTypeLike


_DOUBLE = _Precision(
    1.5 * 2.0**52, (1.5707963267341256, 6.0771005063039659e-11, 2.0222662487959506e-21), 8, jnp.int64
)  # 33 bits each
_SINGLE = _Precision(
    1.5 * 2.0**23, (1.5703125, 4.837512969970703e-4, 7.549789948768648e-8), 5, jnp.int32
)  # 8 to 11 bits


@jax.custom_jvp
def cosine_sine(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Cos and sin of an angle (rad) in its precision: to 3e-16 up to a million turns.

    A single-precision angle may have a thousand turns. Any order of derivative.
    """
    precision = _SINGLE if jnp.result_type(angle) == jnp.float32 else _DOUBLE
    quarters = jnp.round(angle * _QUARTERS)  # not by the magic number: XLA before jax 0.12 takes that back
    high, middle, low = precision.quarter
    rest = ((angle - quarters * high) - quarters * middle) - quarters * low
    square = rest * rest
    sine, cosine = (
        rest * polynomial(_SINE[: precision.terms], square),
        polynomial(_COSINE[: precision.terms + 1], square),
    )
    quarter = lax.bitcast_convert_type(quarters + precision.magic, precision.bits) & 3
    odd = (quarter & 1) == 1
    return (
        jnp.where(odd, sine, cosine) * jnp.where(((quarter + 1) & 2) == 2, -1.0, 1.0),
        jnp.where(odd, cosine, sine) * jnp.where((quarter & 2) == 2, -1.0, 1.0),
    )


@cosine_sine.defjvp
def _cosine_sine_jvp(
    primals: tuple[Scalar], tangents: tuple[Scalar]
) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    cosine, sine = cosine_sine(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])


def double_angle(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar]:
    """Cosine and sine of twice the angle."""
    return 2.0 * cosine * cosine - 1.0, 2.0 * cosine * sine


def triple_angle(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar]:
    """Cosine and sine of three times the angle."""
    return cosine * (4.0 * cosine * cosine - 3.0), sine * (3.0 - 4.0 * sine * sine)
