"""The Kalman filter's covariance algebra for one measured position, in scalars.

Matrices are nested tuples of scalars, so that a control step compiles into one kernel (docs/numerics.md); entries that
are the Python numbers 0.0 and 1.0 cost nothing. The output matrix is C = [1, 0, ..., 0] throughout.
"""

from typing import Any

from diffdrive.parameters import Scalar

Vector = tuple[Scalar, ...]
Matrix = tuple[Vector, ...]


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


def times(matrix: Matrix, vector: Vector) -> Vector:
    """Matrix times vector."""
    return tuple(dot(row, vector) for row in matrix)


def _symmetric(size: int, entry: Any) -> Matrix:
    """The symmetric matrix whose upper triangle is `entry(i, j)`, each computed once."""
    upper = {(i, j): entry(i, j) for i in range(size) for j in range(i, size)}
    return tuple(tuple(upper[min(i, j), max(i, j)] for j in range(size)) for i in range(size))


def predict_covariance(covariance: Matrix, ad: Matrix, process_noise: Vector) -> Matrix:
    """Ad Omega Ad' + diag(Q) (paper, eq. (14))."""
    moved = tuple(times(covariance, row) for row in ad)  # row i: Omega Ad[i]'
    size = len(ad)
    return _symmetric(size, lambda i, j: dot(ad[j], moved[i]) + (process_noise[i] if i == j else 0.0))


def gain(covariance: Matrix, measurement_noise: Scalar) -> Vector:
    """K_s = Omega C' (C Omega C' + R)^-1 (paper, eq. (17))."""
    certainty = 1.0 / (covariance[0][0] + measurement_noise)
    return tuple(row * certainty for row in covariance[0])


def update_covariance(covariance: Matrix, k: Vector, measurement_noise: Scalar) -> Matrix:
    """(I - K C) Omega (I - K C)' + K R K', the Joseph form (paper, eq. (15))."""
    omega = covariance
    spread = omega[0][0] + measurement_noise
    return _symmetric(len(k), lambda i, j: omega[i][j] - k[i] * omega[0][j] - k[j] * omega[0][i] + k[i] * k[j] * spread)


def diagonal(variances: Vector) -> Matrix:
    """The diagonal matrix of these variances; the zeros are arrays of the same type, as a scan's carry needs."""
    return tuple(tuple(v if i == j else 0.0 * v for j in range(len(variances))) for i, v in enumerate(variances))
