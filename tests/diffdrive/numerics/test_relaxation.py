"""What a bristle forgets, over any time and over a short step, and the polynomials that this is made of."""

from decimal import Decimal, localcontext

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from diffdrive.model.friction import deflection_after, relaxation_map
from diffdrive.numerics.polynomial import homogeneous, polynomial, reciprocal
from diffdrive.numerics.relaxation import decay, relaxation

speeds = st.floats(0.0, 1e6)
levels = st.floats(1e-3, 1e5)


@given(top=speeds, bottom=levels)
def test_means_are_those_of_what_is_left(top, bottom):
    """m1 = (1 - e) / x and m2 = (1 - m1) / x, from stick to any traverse: nothing cancels."""
    found = relaxation(jnp.asarray(top), jnp.asarray(bottom))
    whole, end, mean, mean_of_mean = (
        float(one) for one in (found.common_denominator, found.remaining, found.mean, found.mean_of_mean)
    )
    x = top / bottom
    assert 0.0 <= end / whole <= 1.0
    assert 0.0 < mean_of_mean / whole <= 0.5 * (1.0 + 1e-15)
    assert (1.0 + x + x**2 / 2 + x**3 / 6 + x**4 / 24) * end == pytest.approx(whole, rel=1e-14)
    # 1 - m1 over the polynomial is x m2, and nothing cancels in this sum
    assert mean + x * mean_of_mean == pytest.approx(whole, rel=1e-14)


@pytest.mark.parametrize("x", [0.0, 1e-12, 1e-6, 1e-3, 0.03, 0.1, 0.3])
def test_it_is_the_exponential_to_the_fifth_order(x):
    found = relaxation(jnp.asarray(70.0 * x), jnp.asarray(70.0))
    off = float(found.remaining / found.common_denominator) / np.exp(-x) - 1.0
    assert abs(off - x**5 / 120.0) < 0.35 * x**6 + 1e-15  # the first term left out, and what follows it


@given(velocity=st.floats(1e-9, 1.0), bent=st.floats(-2.0, 2.0), duration=st.floats(1e-7, 1e-2))
def test_a_bristle_ends_where_it_does_however_long_the_step(velocity, bent, duration):
    """In its steady state v / r it stays, and it comes no further from it."""
    stiffness, level = 3e7, 80.0
    steady = level / stiffness
    stays, drawn = relaxation_map(stiffness, jnp.asarray(level), jnp.asarray(velocity), duration)
    assert float(stays * steady + drawn) == pytest.approx(steady, rel=1e-13)
    after = float(stays * bent * steady + drawn)
    assert abs(after - steady) <= abs(bent * steady - steady) * (1.0 + 1e-12) + 1e-13 * steady


@pytest.mark.parametrize("velocity", [0.0, 1e-6, 1e-3, 0.01])
def test_a_short_slide_is_the_exact_one(velocity):
    stiffness, level, duration, bristle = 3e7, 80.0, 2e-5, 1.3e-6
    stays, drawn = relaxation_map(stiffness, jnp.asarray(level), jnp.asarray(velocity), duration)
    exact = deflection_after(jnp.asarray(bristle), jnp.asarray(velocity), stiffness * velocity / level, duration)
    assert float(stays * bristle + drawn) == pytest.approx(float(exact), rel=1e-7)


@given(x=st.floats(-3.0, 3.0), y=st.floats(-3.0, 3.0))
def test_a_homogeneous_polynomial_is_one_of_the_ratio(x, y):
    terms = (1.0, -0.5, 2.0, 0.25)
    exact = sum(term * x**k * y ** (3 - k) for k, term in enumerate(terms))
    assert float(homogeneous(terms, x, y)) == pytest.approx(exact, abs=1e-12)
    if y > 0.1:
        assert float(homogeneous(terms, x, y)) == pytest.approx(float(y**3 * polynomial(terms, x / y)), abs=1e-10)


def ratio(pair, part):
    found = relaxation(pair[0], pair[1])
    return jnp.stack(found[:5])[part] * reciprocal(found.common_denominator)


RATIO, FORWARD, BACKWARD, CURVED = (
    jax.jit(one) for one in (ratio, jax.jacfwd(ratio), jax.grad(ratio), jax.hessian(ratio))
)


@pytest.mark.parametrize("at", [(0.0, 1.0), (1e-9, 80.0), (0.3, 0.7), (50.0, 2.0)])
@pytest.mark.parametrize("part", range(5))
def test_slopes_of_first_and_second_order_are_those_of_differences(at, part):
    """At rest, in stick, in sliding and at traverse, in forward and in reverse mode."""
    size = max(at)
    at, step = jnp.asarray(at), 1e-5 * size
    forward, backward = FORWARD(at, part), BACKWARD(at, part)
    np.testing.assert_allclose(forward, backward, rtol=1e-12, atol=1e-14 / size)
    curved = CURVED(at, part)
    for k in range(2):
        way = step * jnp.eye(2)[k]
        slope = (RATIO(at + way, part) - RATIO(at - way, part)) / (2.0 * step)
        np.testing.assert_allclose(forward[k], slope, rtol=1e-6, atol=1e-9 / size)
        along = (BACKWARD(at + way, part) - BACKWARD(at - way, part)) / (2.0 * step)
        np.testing.assert_allclose(curved[k], along, rtol=1e-5, atol=1e-8 / size**2)


@pytest.mark.long
def test_there_are_derivatives_of_higher_orders():
    """Of exp(-x) at rest: -1, 1, -1, 1, up to the fourth; the fifth is where the fraction ends."""

    def end(x):
        found = relaxation(x, jnp.asarray(1.0))
        return found.remaining * reciprocal(found.common_denominator)

    slope = end
    for order in range(1, 6):
        slope = jax.grad(slope)
        expected = (-1.0) ** order if order < 5 else 0.0
        assert float(slope(jnp.asarray(0.0))) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(("top", "bottom"), [(1e6, 10.0), (1e-7, 1e-5), (2e-5, 1e-5), (3e4, 0.1)])
def test_single_precision_holds_for_stiff_bristles_and_small_levels(top, bottom):
    """Values and slopes, as those in double: 1 m/s, 1 ms, 1e9 N/m, 10 N; and a dwell that forgets over 10 um."""

    def mean(top, bottom):
        found = relaxation(top, bottom)
        return found.mean * reciprocal(found.common_denominator)

    def all_of(kind):
        at = (jnp.asarray(top, kind), jnp.asarray(bottom, kind))
        return np.array([mean(*at), *jax.grad(mean, (0, 1))(*at)])

    np.testing.assert_allclose(all_of(jnp.float32), all_of(jnp.float64), rtol=1e-4)


DECAY_POINTS = np.concatenate(
    [
        [0.0],
        np.logspace(-12, 5, 120),
        np.nextafter(0.05, [0, 1]),
        [0.05],
        np.log(2.0) / 2 * np.array([1.0 - 1e-15, 1.0, 1.0 + 1e-15]),
    ]
)


def exact_decay(x):
    """Both functions and their derivatives in 60 digits."""
    with localcontext() as context:
        context.prec = 60
        x = Decimal(float(x))
        if x == 0:
            return [1.0, 1.0], [-1.0, -0.5]
        end = (-x).exp()
        mean = (1 - end) / x
        return [float(q) for q in (end, mean)], [float(q) for q in (-end, (end - mean) / x)]


def test_decay_and_its_derivative():
    values = jax.vmap(decay)(jnp.asarray(DECAY_POINTS))
    slopes = jax.vmap(jax.jacfwd(decay))(jnp.asarray(DECAY_POINTS))
    reverse = [jax.vmap(jax.grad(lambda x, i=i: decay(x)[i]))(jnp.asarray(DECAY_POINTS)) for i in range(2)]
    exact = [exact_decay(x) for x in DECAY_POINTS]
    for i, tolerance in enumerate((1e-14, 1e-12)):
        np.testing.assert_allclose(values[i], [e[0][i] for e in exact], rtol=1e-14, atol=1e-30)
        np.testing.assert_allclose(slopes[i], [e[1][i] for e in exact], rtol=tolerance, atol=1e-30)
        np.testing.assert_allclose(reverse[i], slopes[i], rtol=tolerance, atol=1e-30)


@pytest.mark.parametrize("x", [0.0, 1e-3, 0.049, 0.051, 0.3, 0.4, 3.0, 30.0])
def test_second_derivatives_of_the_decay(x):
    """The mean is an integral of exp(-x s): twice differentiated, of s^2 times it."""
    end, mean = jax.jacfwd(jax.jacfwd(decay))(jnp.asarray(x))
    assert float(end) == pytest.approx(np.exp(-x), rel=1e-13)
    assert float(mean) == pytest.approx(quad(lambda s: s**2 * np.exp(-x * s), 0, 1)[0], rel=1e-7)


def test_the_decay_in_single_precision():
    x = jnp.asarray(DECAY_POINTS, jnp.float32)
    found, exact = jax.vmap(decay)(x), [exact_decay(one)[0] for one in np.asarray(x)]
    for one, right in zip(found, zip(*exact, strict=True), strict=True):
        assert one.dtype == jnp.float32
        np.testing.assert_allclose(one, right, rtol=1e-6, atol=1e-30)
