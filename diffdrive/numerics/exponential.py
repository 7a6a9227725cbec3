"""exp(-x) and 2^-y, where they are a third of a control step.

XLA's own exponential handles every special case; friction needs x between 0 and some hundreds, eighteen times a step.
These functions are accurate to rounding there (4e-16), branch-free, and vectorise: x = n ln 2 - r, |r| < ln 2 / 2,
exp(r) by a polynomial in Estrin's order, and 2^-n written into the exponent's bits. A single-precision argument gives
single precision (2e-7), by the same steps with fewer terms.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Bool

from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import polynomial

MAX_ARGUMENT = 670.0  # exp(-670) is 1e-291: as good as nothing, and still a normal number
MAX_ARGUMENT_SINGLE = 70.0  # the same for a float: exp(-70) is 4e-31
MIN_BASE = 1e-12  # below it the power is taken as zero
MAX_LOG2_POWER = 40.0  # two to this is the largest power
LOG2_E, LN2 = math.log2(math.e), math.log(2.0)
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # the first has 20 trailing zero bits
_LN2_HIGH_SINGLE, _LN2_LOW_SINGLE = 0.693359375, -2.12194440e-4  # the first has 14 trailing zero bits
_MAGIC, _MAGIC_SINGLE = 1.5 * 2.0**52, 1.5 * 2.0**23  # beside it a whole number stands in the last bits

# the bits of 1 / sqrt(2), and those beside which a whole number stands in the last bits of 1.5 2^52 and 1.5 2^23
_ROOT_HALF, _WHOLE_BITS = 0x3FE6A09E667F3BCD, 0x4338000000000000
_ROOT_HALF_SINGLE, _WHOLE_BITS_SINGLE = 0x3F3504F3, 0x4B400000
_ARTANH = tuple(2.0 / (LN2 * (2 * k + 1)) for k in range(11))  # the first term left out is 1e-18 at s = 0.172

# exp(r) = 1 + r + r^2 P(r); the first term left out is 3e-17 at |r| = ln 2 / 2
_EXP_COEFFICIENTS = tuple(1.0 / math.factorial(k + 2) for k in range(12))


class ExpNegParts(NamedTuple):
    """exp(-x), and what it is made of where x is small."""

    value: Scalar  # exp(-x)
    small: Bool[Array, ""] | bool  # whether x < ln 2 / 2: there exp(-x) = 1 - x + x^2 series
    series: Scalar  # to rounding; in single precision to 2e-6


@jax.custom_jvp
def exp_neg(x: Scalar) -> Scalar:
    """exp(-x) in the precision of x >= 0, or not far below; NaN stays NaN. Any order of derivative."""
    return exp_neg_parts(x).value


@exp_neg.defjvp
def _exp_neg_jvp(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    (x,), (tangent,) = primals, tangents
    value = exp_neg(x)
    return value, -value * tangent


def exp_neg_parts(x: Scalar) -> ExpNegParts:
    """exp(-x) with its parts; its derivatives are the caller's."""
    single = _is_single(x)
    high, low = (_LN2_HIGH_SINGLE, _LN2_LOW_SINGLE) if single else (_LN2_HIGH, _LN2_LOW)
    x = jnp.minimum(x, MAX_ARGUMENT_SINGLE if single else MAX_ARGUMENT)
    shifted, n = _nearest(x * LOG2_E)
    r = (n * high - x) + n * low
    r2, near, far = _series(r)
    series = near + r2 * (r2 * far)
    return ExpNegParts((1.0 + (r + r2 * series)) * _exp2_neg_whole(shifted), n == 0.0, series)


@jax.custom_jvp
def exp2_neg(y: Scalar) -> Scalar:
    """2^-y in the precision of y, from -`MAX_LOG2_POWER` on; NaN stays NaN. Any order of derivative.

    A single lane waits for each result. So y - n is a subtraction, the bound comes last, and 2^-n multiplies the parts
    of the polynomial while the rest of it is computed.
    """
    limit = (MAX_ARGUMENT_SINGLE if _is_single(y) else MAX_ARGUMENT) * LOG2_E
    shifted, n = _nearest(y)
    scale, r = _exp2_neg_whole(shifted), (n - y) * LN2
    r2, near, far = _series(r)
    value = scale * ((1.0 + r) + r2 * near) + (scale * (r2 * r2 * r2)) * far
    return jnp.where(y > limit, 2.0**-limit, value)


@exp2_neg.defjvp
def _exp2_neg_jvp(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    (y,), (tangent,) = primals, tangents
    value = once(exp2_neg(y))  # once, however many tangents there are
    return value, value * (-LN2 * tangent)


@jax.custom_jvp
def bounded_power(y: Scalar, power: Scalar) -> Scalar:
    """y^power of y >= 0, at most 2^40, with slopes that are finite at y = 0 also where the power is below one."""
    representable = y >= MIN_BASE  # and no NaN, which stays one
    log2_power = jnp.minimum(power * _log2(jnp.where(representable, y, 1.0)), MAX_LOG2_POWER)
    return jnp.where(representable, exp2_neg(-log2_power), 0.0 * y)


@bounded_power.defjvp
def _bounded_power_jvp(primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]) -> tuple[Scalar, Scalar]:
    (y, power), (tangent_y, tangent_power) = primals, tangents
    small = y < MIN_BASE
    safe = jnp.where(small, 1.0, y)  # keeps the branch not taken, and its derivative, finite
    value = bounded_power(y, power)
    bounded = jnp.where(small | (value >= 2.0**MAX_LOG2_POWER), 0.0, value)
    # XLA's logarithm, since a second derivative needs the slope of it
    value, by_y, by_power = once((value, bounded * power / safe, bounded * jnp.log(safe)))
    return value, by_y * tangent_y + by_power * tangent_power


def _log2(y: Scalar) -> Scalar:
    """The logarithm to base two of a normal number, to rounding: e + log2 m of y = m 2^e, m from 1/sqrt(2) to sqrt(2).

    The whole part is read from the bits; log2 m = 2 / ln 2 artanh((m - 1) / (m + 1)) by its series.
    """
    if _is_single(y):
        bits = lax.bitcast_convert_type(y, jnp.int32)
        e = (bits - jnp.int32(_ROOT_HALF_SINGLE)) >> 23
        m = lax.bitcast_convert_type(bits - (e << 23), jnp.float32)
        whole = lax.bitcast_convert_type(e + jnp.int32(_WHOLE_BITS_SINGLE), jnp.float32) - jnp.float32(_MAGIC_SINGLE)
    else:
        bits = lax.bitcast_convert_type(y, jnp.int64)
        e = (bits - _ROOT_HALF) >> 52
        m = lax.bitcast_convert_type(bits - (e << 52), jnp.float64)
        whole = lax.bitcast_convert_type(e + _WHOLE_BITS, jnp.float64) - _MAGIC
    s = (m - 1.0) / (m + 1.0)
    return whole + s * polynomial(_ARTANH[:5] if _is_single(y) else _ARTANH, s * s)


def _is_single(x: Scalar) -> bool:
    return bool(jnp.result_type(x) == jnp.float32)


def _nearest(y: Scalar) -> tuple[Scalar, Scalar]:
    """The whole number n nearest to y: in the last bits of a large number, and itself.

    Not as (y + magic) - magic, which XLA before jax 0.12 takes for y itself.
    """
    n = jnp.round(y)
    return n + (_MAGIC_SINGLE if _is_single(y) else _MAGIC), n


def _exp2_neg_whole(shifted: Scalar) -> Scalar:
    """2^-n, of n in the last bits of a large number."""
    if _is_single(shifted):
        bits = lax.bitcast_convert_type(shifted, jnp.int32)
        return lax.bitcast_convert_type((127 - bits) << 23, jnp.float32)
    bits = lax.bitcast_convert_type(shifted, jnp.int64)
    return lax.bitcast_convert_type((1023 - bits) << 52, jnp.float64)


def _series(r: Scalar) -> tuple[Scalar, Scalar, Scalar]:
    """r^2, and P(r) as its first four terms and r^4 times the others."""
    r2 = r * r
    near = (_EXP_COEFFICIENTS[0] + _EXP_COEFFICIENTS[1] * r) + (_EXP_COEFFICIENTS[2] + _EXP_COEFFICIENTS[3] * r) * r2
    if _is_single(r):
        return r2, near, _EXP_COEFFICIENTS[4]
    r4 = r2 * r2
    middle = (_EXP_COEFFICIENTS[4] + _EXP_COEFFICIENTS[5] * r) + (_EXP_COEFFICIENTS[6] + _EXP_COEFFICIENTS[7] * r) * r2
    high = (_EXP_COEFFICIENTS[8] + _EXP_COEFFICIENTS[9] * r) + (_EXP_COEFFICIENTS[10] + _EXP_COEFFICIENTS[11] * r) * r2
    return r2, near, middle + r4 * high
