"""Polynomials by Horner's scheme, and reciprocals: the parts of the loop's exponentials, waves and decays."""

from functools import partial

import jax

from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once

Coefficients = tuple[float, ...]


def polynomial(coefficients: Coefficients, x: Scalar) -> Scalar:
    """c0 + c1 x + c2 x^2 + ..."""
    total: Scalar = coefficients[-1]
    for term in reversed(coefficients[:-1]):
        total = term + x * total
    return total


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def homogeneous(coefficients: Coefficients, x: Scalar, y: Scalar) -> Scalar:
    """c0 y^n + c1 x y^(n-1) + ... + cn x^n: y^n times the polynomial of x / y, without a division."""
    total: Scalar = coefficients[-1]
    power: Scalar = 1.0
    for term in reversed(coefficients[:-1]):
        power = power * y
        total = term * power + x * total
    return total


@homogeneous.defjvp
def _homogeneous_jvp(
    coefficients: Coefficients, primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]
) -> tuple[Scalar, Scalar]:
    """By two slopes, computed once however many tangents there are."""
    degree = len(coefficients) - 1
    by_x = tuple(k * term for k, term in enumerate(coefficients))[1:] or (0.0,)
    by_y = tuple((degree - k) * term for k, term in enumerate(coefficients))[:-1] or (0.0,)
    values = (homogeneous(coefficients, *primals), homogeneous(by_x, *primals), homogeneous(by_y, *primals))
    value, slope_x, slope_y = once(values)
    return value, slope_x * tangents[0] + slope_y * tangents[1]


@jax.custom_jvp
def reciprocal(x: Scalar) -> Scalar:
    """1 / x."""
    return 1.0 / x


@reciprocal.defjvp
def _reciprocal_jvp(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    """Without a further division."""
    value = once(reciprocal(*primals))
    return value, -value * (value * tangents[0])  # the square of a small number is none in single precision
