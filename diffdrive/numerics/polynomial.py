"""Polynomials in the order of Horner, and quotients: what the loop's exponentials, waves and decays are made of."""

from functools import partial

import jax

from diffdrive.model.parameters import Scalar
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
def _homogeneous_slope(
    coefficients: Coefficients, primals: tuple[Scalar, Scalar], tangents: tuple[Scalar, Scalar]
) -> tuple[Scalar, Scalar]:
    """By two slopes, computed once however many tangents there are."""
    degree = len(coefficients) - 1
    by_x = tuple(k * term for k, term in enumerate(coefficients))[1:] or (0.0,)
    by_y = tuple((degree - k) * term for k, term in enumerate(coefficients))[:-1] or (0.0,)
    found = (homogeneous(coefficients, *primals), homogeneous(by_x, *primals), homogeneous(by_y, *primals))
    value, along_x, along_y = once(found)
    return value, along_x * tangents[0] + along_y * tangents[1]


@jax.custom_jvp
def reciprocal(bottom: Scalar) -> Scalar:
    """1 / bottom."""
    return 1.0 / bottom


@reciprocal.defjvp
def _inverse_slope(primals: tuple[Scalar], tangents: tuple[Scalar]) -> tuple[Scalar, Scalar]:
    """Without a further division."""
    found = once(reciprocal(*primals))
    return found, -found * (found * tangents[0])  # the square of a small number is none in single precision
