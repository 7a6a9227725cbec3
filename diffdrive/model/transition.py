"""The matrix exponential of the drive's linear model at frozen velocity, in closed form.

    d/dt [v, z] = [[-a, -b], [1, -r]] [v, z] + inputs ,   dx/dt = v

(paper, eq. (8), with a = (s1 + mu_v + B_S) / M, b = s0 (1 - s1 |v| / g) / M, r = s0 |v| / g). In scalars, because a
library's `expm` in a scan costs twenty times the rest of the control step (docs/method/numerics.md).

With m = (a + r) / 2 and D = ((a - r) / 2)^2 - b, and exp(A t) = c(t) I + s(t) (A + m I), the integrals over time follow
from the same two functions, since A is regular (det A = a r + b > 0):

    int s = (1 - c - m s) / det ,   int c = s + m int s ,   and once more for the double integrals.
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from diffdrive.model.friction import LuGreCoefficients
from diffdrive.model.parameters import Plant
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.exponential import exp_neg
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import polynomial

Matrix2 = tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]


class Transition(NamedTuple):
    """exp(A T) of [v, z], its integral and its double integral over 0..T."""

    exponential: Matrix2
    integral: Matrix2
    double_integral: Matrix2


# cosh(sqrt p) and sinh(sqrt p) / sqrt p as power series in p; ten terms leave 1e-16 for |p| <= (pi / 2)^2
_EVEN = tuple(1.0 / math.factorial(2 * n) for n in range(11))
_ODD = tuple(1.0 / math.factorial(2 * n + 1) for n in range(11))


_ODD_SLOPE = tuple(n * term for n, term in enumerate(_ODD))[1:]


@jax.custom_jvp
def _cosh_sinh_sqrt(p: Scalar) -> tuple[Scalar, Scalar]:
    """cosh(sqrt p) and sinh(sqrt p) / sqrt p; p < 0 gives cos(sqrt -p) and sin(sqrt -p) / sqrt -p."""
    return polynomial(_EVEN, p), polynomial(_ODD, p)


@_cosh_sinh_sqrt.defjvp
def _cosh_sinh_sqrt_jvp(
    primals: tuple[Scalar], tangents: tuple[Scalar]
) -> tuple[tuple[Scalar, Scalar], tuple[Scalar, Scalar]]:
    (p,), (tangent,) = primals, tangents
    even, odd = _cosh_sinh_sqrt(p)
    return (even, odd), (0.5 * odd * tangent, polynomial(_ODD_SLOPE, p) * tangent)


def _cosh_sinh(mean_rate: Scalar, discriminant: Scalar, determinant: Scalar, time: Scalar) -> tuple[Scalar, Scalar]:
    """exp(-m t) cosh(sqrt(D) t) and exp(-m t) sinh(sqrt(D) t) / sqrt(D), for D of either sign, and at D = 0.

    Well separated real eigenvalues by their exponentials; all else by series, an angle first reduced to half a turn.
    (A library's sin and cos do not vectorise here and cost more than the rest of the observer.)
    """
    q = discriminant * time**2
    is_real, is_complex = q > 0.25, q < -0.25
    root = jnp.sqrt(jnp.where(is_real | is_complex, jnp.abs(q), 1.0))
    per_root = 1.0 / root
    # real and apart: the slow eigenvalue from det / (m + sqrt D), which does not cancel
    fast = mean_rate * time + jnp.where(is_real, root, 0.0)
    slow_or_mean = exp_neg(jnp.where(is_real, determinant * time**2 / fast, mean_rate * time))
    fast_end = exp_neg(fast)
    # cosh and sinh each read them, and would compute them again
    slow_or_mean, fast_end = once((slow_or_mean, fast_end))
    # the rest: half the angle, or q itself, into the series; then double once
    angle = jnp.where(is_complex, root - 2 * jnp.pi * jnp.round(root * (0.5 / jnp.pi)), 0.0)
    p = jnp.where(is_real, 0.0, jnp.where(is_complex, -(angle**2), q)) / 4
    half_even, half_odd = _cosh_sinh_sqrt(p)
    half_even, half_odd = once((half_even, half_odd))
    even, odd = 2 * half_even**2 - 1, half_even * half_odd * jnp.where(is_complex, angle * per_root, 1.0)
    cosh = jnp.where(is_real, 0.5 * (slow_or_mean + fast_end), slow_or_mean * even)
    sinh = jnp.where(is_real, 0.5 * (slow_or_mean - fast_end) * per_root, slow_or_mean * odd)
    return once((cosh, time * sinh))


def transition(plant: Plant, bristle: LuGreCoefficients, velocity: Scalar, time: Scalar) -> Transition:
    """`Transition` over `time` (s) with the friction coefficients frozen at `velocity` (m/s)."""
    rate = bristle.rate
    viscous_sum = bristle.viscous + plant.damping.towards(velocity)
    inverse_mass = 1.0 / plant.mass
    a = (bristle.damping + viscous_sum) * inverse_mass
    b = (bristle.stiffness - bristle.damping * rate) * inverse_mass
    determinant = (bristle.stiffness + viscous_sum * rate) * inverse_mass  # a r + b, without the cancellation
    per_determinant = 1.0 / determinant
    m = 0.5 * (a + rate)
    half_difference = 0.5 * (a - rate)
    c, s = _cosh_sinh(m, half_difference**2 - b, determinant, time)

    def combine(even: Scalar, odd: Scalar) -> Matrix2:
        return ((even - odd * half_difference, -odd * b), (odd, even + odd * half_difference))

    int_s = (1.0 - c - m * s) * per_determinant
    int_c = s + m * int_s
    int2_s = (time - int_c - m * int_s) * per_determinant
    int2_c = int_s + m * int2_s
    return once(Transition(combine(c, s), combine(int_c, int_s), combine(int2_c, int2_s)))


def state_matrices(
    plant: Plant, bristle: LuGreCoefficients, velocity: Scalar, time: Scalar
) -> tuple[tuple[tuple[Scalar, ...], ...], tuple[Scalar, ...]]:
    """Ad (3 by 3) and Bd (3) of X = [x, v, z] under a constant force (paper, eqs. (8) and (9)), as nested tuples."""
    exponential, integral, double = transition(plant, bristle, velocity, time)
    ad = ((1.0, *integral[0]), (0.0, *exponential[0]), (0.0, *exponential[1]))
    inverse_mass = 1.0 / plant.mass
    bd = (double[0][0] * inverse_mass, integral[0][0] * inverse_mass, integral[1][0] * inverse_mass)
    return ad, bd
