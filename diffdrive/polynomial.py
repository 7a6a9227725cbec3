"""Polynomials in the order of Horner: what the loop's exponentials, waves and decays are made of."""

from diffdrive.parameters import Scalar


def polynomial(coefficients: tuple[float, ...], x: Scalar) -> Scalar:
    """c0 + c1 x + c2 x^2 + ..."""
    total: Scalar = coefficients[-1]
    for term in reversed(coefficients[:-1]):
        total = term + x * total
    return total
