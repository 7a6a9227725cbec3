"""Determinant and inverse of a curvature, against fractions without rounding."""

from fractions import Fraction

import numpy as np
import pytest

from tuning.identification.controller.search import Curvature


def exact(jacobian):
    """The determinant of J'J and its inverse, of a Jacobian with two columns."""
    rows = [[Fraction(float(entry)) for entry in row] for row in jacobian]
    (a, b), (_, d) = [[sum(row[i] * row[k] for row in rows) for k in range(2)] for i in range(2)]
    determinant = a * d - b * b
    return float(determinant), np.array([[float(d), float(-b)], [float(-b), float(a)]]) / float(determinant)


@pytest.mark.parametrize("worth", [1.0, 1e6, 1e9])
def test_determinant_and_inverse_are_kept_where_the_product_is_singular_to_rounding(worth):
    """Moments that show one combination of both parameters, and an expectation of each of them."""
    jacobian = np.array([[worth, worth], [1.0, 0.0], [0.0, 1e-3]])
    determinant, inverse = exact(jacobian)
    found = Curvature.of(jacobian)
    assert found.log_determinant == pytest.approx(np.log(determinant), abs=1e-5)
    np.testing.assert_allclose(found.inverse, inverse, rtol=1e-5)
