"""Cosine and sine together, in double precision: what waves in time and in position are made of.

A library's do not vectorise here and cost more than the rest of a control step. The angle is brought within an eighth
of a turn of a multiple of a quarter turn, both series are summed, and the quarter decides which is which.
"""

import math

import jax
import jax.numpy as jnp
from jax import lax

from diffdrive.parameters import Scalar
from diffdrive.polynomial import polynomial

_QUARTERS = 2.0 / math.pi
_HIGH, _MIDDLE, _LOW = 1.5707963267341256, 6.0771005063039659e-11, 2.0222662487959506e-21  # pi / 2, 33 bits each
_MAGIC = 1.5 * 2.0**52  # a number beside it is rounded to a whole one, which then stands in its last bits
_SINE = tuple((-1) ** k / math.factorial(2 * k + 1) for k in range(8))  # in r^2; what is left out is 5e-17
_COSINE = tuple((-1) ** k / math.factorial(2 * k) for k in range(9))


@jax.custom_jvp
def cosine_sine(angle: Scalar) -> tuple[Scalar, Scalar]:
    """Cos and sin of an angle (rad), to 3e-16 as long as it is below a million turns. Any order of derivative."""
    shifted = angle * _QUARTERS + _MAGIC
    quarters = shifted - _MAGIC
    rest = ((angle - quarters * _HIGH) - quarters * _MIDDLE) - quarters * _LOW
    square = rest * rest
    sine, cosine = rest * polynomial(_SINE, square), polynomial(_COSINE, square)
    quarter = lax.bitcast_convert_type(shifted, jnp.int64) & 3
    odd = (quarter & 1) == 1
    return (
        jnp.where(odd, sine, cosine) * jnp.where(((quarter + 1) & 2) == 2, -1.0, 1.0),
        jnp.where(odd, cosine, sine) * jnp.where((quarter & 2) == 2, -1.0, 1.0),
    )


@cosine_sine.defjvp
def _turned(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    cosine, sine = cosine_sine(*primals)
    return (cosine, sine), (-sine * tangents[0], cosine * tangents[0])


def doubled(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar]:
    """Of twice the angle."""
    return 2.0 * cosine * cosine - 1.0, 2.0 * cosine * sine


def tripled(cosine: Scalar, sine: Scalar) -> tuple[Scalar, Scalar]:
    """Of three times the angle."""
    return cosine * (4.0 * cosine * cosine - 3.0), sine * (3.0 - 4.0 * sine * sine)
