"""The Kalman filter's covariance algebra for one measured position, in scalars.

Matrices are nested tuples of scalars, so that a control step compiles into one kernel (docs/method/numerics.md);
entries that are the Python numbers 0.0 and 1.0 cost nothing. A covariance is its upper triangle, row by row: a compiler
cannot know that the other half is equal, and would compute, carry and, in reverse mode, store it too. The output matrix
is C = [1, 0, ..., 0], but in what ends in `along`.
"""

from collections.abc import Callable

from diffdrive.numerics.arrays import Scalar

Vector = tuple[Scalar, ...]
Matrix = tuple[Vector, ...]
Triangle = tuple[Vector, ...]  # row i from the diagonal on


def _equals(entry: object, number: float) -> bool:
    return isinstance(entry, float) and entry == number


def dot(a: Vector, b: Vector) -> Scalar:
    """Inner product; exact Python zeros and ones are folded away."""
    total: Scalar = 0.0
    for p, q in zip(a, b, strict=True):
        if _equals(p, 0.0) or _equals(q, 0.0):
            continue
        term = q if _equals(p, 1.0) else p if _equals(q, 1.0) else p * q
        total = term if _equals(total, 0.0) else total + term
    return total


def matvec(matrix: Matrix, vector: Vector) -> Vector:
    """Matrix times vector."""
    return tuple(dot(row, vector) for row in matrix)


def _triangle(size: int, entry: Callable[[int, int], Scalar]) -> Triangle:
    return tuple(tuple(entry(i, j) for j in range(i, size)) for i in range(size))


def full_matrix(covariance: Triangle) -> Matrix:
    """The symmetric matrix with this upper triangle."""
    size = len(covariance)
    return tuple(tuple(covariance[min(i, j)][abs(i - j)] for j in range(size)) for i in range(size))


def predict_covariance(covariance: Triangle, ad: Matrix, process_noise: Vector) -> Triangle:
    """Ad Omega Ad' + diag(Q) (paper, eq. (14))."""
    full = full_matrix(covariance)
    propagated = tuple(matvec(full, row) for row in ad)  # row i: Omega Ad[i]'
    size = len(ad)
    return _triangle(size, lambda i, j: dot(ad[j], propagated[i]) + (process_noise[i] if i == j else 0.0))


def kalman_gain(covariance: Triangle, measurement_noise: Scalar) -> Vector:
    """K_s = Omega C' (C Omega C' + R)^-1 (paper, eq. (17))."""
    precision = 1.0 / (covariance[0][0] + measurement_noise)
    return tuple(row * precision for row in covariance[0])


def update_covariance(covariance: Triangle, gain: Vector, measurement_noise: Scalar) -> Triangle:
    """(I - K C) Omega (I - K C)' + K R K', the Joseph form (paper, eq. (15))."""
    first_row, innovation_variance = covariance[0], covariance[0][0] + measurement_noise
    return _triangle(
        len(gain),
        lambda i, j: (
            covariance[i][j - i]
            - gain[i] * first_row[j]
            - gain[j] * first_row[i]
            + gain[i] * gain[j] * innovation_variance
        ),
    )


def kalman_gain_along(covariance: Triangle, output: Vector, measurement_noise: Scalar) -> tuple[Vector, Vector, Scalar]:
    """The gain of a measurement of C = `output`; with Omega C' and the variance of the innovation."""
    seen = matvec(full_matrix(covariance), output)
    variance = dot(output, seen) + measurement_noise
    precision = 1.0 / variance
    return tuple(row * precision for row in seen), seen, variance


def update_covariance_along(covariance: Triangle, gain: Vector, seen: Vector, innovation_variance: Scalar) -> Triangle:
    """The Joseph form for any output and any gain, with `seen` = Omega C'; a gain of zero changes nothing."""
    return _triangle(
        len(gain),
        lambda i, j: (
            covariance[i][j - i] - gain[i] * seen[j] - gain[j] * seen[i] + gain[i] * gain[j] * innovation_variance
        ),
    )


def diagonal(variances: Vector) -> Triangle:
    """The diagonal matrix of these variances; the zeros are arrays of the same type, as a scan's carry needs."""
    return _triangle(len(variances), lambda i, j: variances[i] if i == j else 0.0 * variances[i])
