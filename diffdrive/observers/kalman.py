"""The Kalman filter's covariance algebra for one measured position, in scalars.

Matrices are nested tuples of scalars, so that a control step compiles into one kernel (docs/method/numerics.md);
entries that are the Python numbers 0.0 and 1.0 cost nothing. A covariance is its upper triangle, row by row: what a
compiler cannot know to be equal it would compute, carry and, in reverse mode, keep twice. The output matrix is C = [1,
0, ..., 0] throughout.
"""

from typing import Any

from diffdrive.model.parameters import Scalar

Vector = tuple[Scalar, ...]
Matrix = tuple[Vector, ...]
Triangle = tuple[Vector, ...]  # row i from the diagonal on


def _is(entry: Any, number: float) -> bool:
    return isinstance(entry, float) and entry == number


def dot(a: Vector, b: Vector) -> Scalar:
    """Inner product; exact Python zeros and ones are folded away."""
    total: Scalar = 0.0
    for p, q in zip(a, b, strict=True):
        if _is(p, 0.0) or _is(q, 0.0):
            continue
        term = q if _is(p, 1.0) else p if _is(q, 1.0) else p * q
        total = term if _is(total, 0.0) else total + term
    return total


def matvec(matrix: Matrix, vector: Vector) -> Vector:
    """Matrix times vector."""
    return tuple(dot(row, vector) for row in matrix)


def _triangle(size: int, entry: Any) -> Triangle:
    return tuple(tuple(entry(i, j) for j in range(i, size)) for i in range(size))


def full_matrix(covariance: Triangle) -> Matrix:
    """The matrix of which this is the upper triangle."""
    size = len(covariance)
    return tuple(tuple(covariance[min(i, j)][abs(i - j)] for j in range(size)) for i in range(size))


def predict_covariance(covariance: Triangle, ad: Matrix, process_noise: Vector) -> Triangle:
    """Ad Omega Ad' + diag(Q) (paper, eq. (14))."""
    omega = full_matrix(covariance)
    moved = tuple(matvec(omega, row) for row in ad)  # row i: Omega Ad[i]'
    size = len(ad)
    return _triangle(size, lambda i, j: dot(ad[j], moved[i]) + (process_noise[i] if i == j else 0.0))


def kalman_gain(covariance: Triangle, measurement_noise: Scalar) -> Vector:
    """K_s = Omega C' (C Omega C' + R)^-1 (paper, eq. (17))."""
    certainty = 1.0 / (covariance[0][0] + measurement_noise)
    return tuple(row * certainty for row in covariance[0])


def update_covariance(covariance: Triangle, k: Vector, measurement_noise: Scalar) -> Triangle:
    """(I - K C) Omega (I - K C)' + K R K', the Joseph form (paper, eq. (15))."""
    first, spread = covariance[0], covariance[0][0] + measurement_noise
    return _triangle(
        len(k), lambda i, j: covariance[i][j - i] - k[i] * first[j] - k[j] * first[i] + k[i] * k[j] * spread
    )


def diagonal(variances: Vector) -> Triangle:
    """The diagonal matrix of these variances; the zeros are arrays of the same type, as a scan's carry needs."""
    return _triangle(len(variances), lambda i, j: variances[i] if i == j else 0.0 * variances[i])
