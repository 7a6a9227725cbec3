"""exp(-x), where it is a third of a control step.

XLA's own exponential takes care of every corner of a float; friction asks for x between 0 and some hundreds, eighteen
times a step. This one is right to rounding there (4e-16), branchless, and vectorises: x = n ln 2 - r, |r| < ln 2 / 2,
exp(r) by a polynomial in Estrin's order, and 2^-n written into the exponent's bits. Of a single-precision number it is
the single-precision exponential (2e-7), by the same steps with fewer terms.
"""

import math

import jax
import jax.numpy as jnp
from jax import lax

from diffdrive.parameters import Scalar

FARTHEST = 700.0  # exp(-700) is 1e-304: as good as nothing, and 2^-n is still a normal number
_LOG2_E = 1.4426950408889634
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # the first has 20 trailing zero bits
_MAGIC = 1.5 * 2.0**52  # a number beside it is rounded to a whole one, which then stands in its last bits


# exp(r) = 1 + r + r^2 P(r); the first term left out is 3e-17 at |r| = ln 2 / 2
_P = tuple(1.0 / math.factorial(k + 2) for k in range(12))


FARTHEST_SINGLE = 87.0  # the same for a float: exp(-87) is 2e-38
_LN2_HIGH_SINGLE, _LN2_LOW_SINGLE = 0.693359375, -2.12194440e-4  # the first has 14 trailing zero bits
_MAGIC_SINGLE = 1.5 * 2.0**23


@jax.custom_jvp
def fading(x: Scalar) -> Scalar:
    """exp(-x) in the precision of x >= 0, or not far below; NaN stays NaN. Any order of derivative."""
    return _single(x) if jnp.result_type(x) == jnp.float32 else _double(x)


def _double(x: Scalar) -> Scalar:
    x = jnp.minimum(x, FARTHEST)
    shifted = x * _LOG2_E + _MAGIC
    n = shifted - _MAGIC
    r = (n * _LN2_HIGH - x) + n * _LN2_LOW
    r2 = r * r
    r4 = r2 * r2
    low = (_P[0] + _P[1] * r) + (_P[2] + _P[3] * r) * r2
    middle = (_P[4] + _P[5] * r) + (_P[6] + _P[7] * r) * r2
    high = (_P[8] + _P[9] * r) + (_P[10] + _P[11] * r) * r2
    power = 1.0 + (r + r2 * (low + r4 * (middle + r4 * high)))
    bits = lax.bitcast_convert_type(shifted, jnp.int64)
    scale = lax.bitcast_convert_type((1023 - bits) << 52, jnp.float64)
    return power * scale


def _single(x: Scalar) -> Scalar:
    x = jnp.minimum(x, FARTHEST_SINGLE)
    shifted = x * _LOG2_E + _MAGIC_SINGLE
    n = shifted - _MAGIC_SINGLE
    r = (n * _LN2_HIGH_SINGLE - x) + n * _LN2_LOW_SINGLE
    r2 = r * r
    series = (_P[0] + _P[1] * r) + ((_P[2] + _P[3] * r) + _P[4] * r2) * r2
    bits = lax.bitcast_convert_type(shifted, jnp.int32)
    return (1.0 + (r + r2 * series)) * lax.bitcast_convert_type((127 - bits) << 23, jnp.float32)


@fading.defjvp
def _fading_slope(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    (x,), (along,) = primals, tangents
    end = fading(x)
    return end, -end * along
