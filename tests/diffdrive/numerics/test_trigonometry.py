"""The step's own cosine and sine against the exact ones."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.numerics.trigonometry import cosine_sine, double_angle, triple_angle

COMPILED = jax.jit(cosine_sine)


def exact(angle):
    angle = np.asarray(angle, np.longdouble)
    return np.cos(angle), np.sin(angle)


@given(st.floats(-6e6, 6e6))
def test_they_are_cosine_and_sine_to_rounding(angle):
    for ours, true in zip(COMPILED(angle), exact(angle), strict=True):
        assert abs(np.longdouble(float(ours)) - true) < 3e-16


def test_they_are_so_where_the_quarter_changes():
    edges = (np.arange(-400, 400) + 0.5) * (np.pi / 2)
    angle = np.concatenate([np.nextafter(edges, -1e9), edges, np.nextafter(edges, 1e9), np.arange(-40, 40) * np.pi / 2])
    for ours, true in zip(COMPILED(angle), exact(angle), strict=True):
        assert np.max(np.abs(np.asarray(ours) - true)) < 3e-16


@given(st.floats(-6e3, 6e3, width=32))
def test_of_a_float_they_are_those_of_a_float(angle):
    for ours, true in zip(COMPILED(jnp.float32(angle)), exact(angle), strict=True):
        assert ours.dtype == jnp.float32
        assert abs(np.longdouble(float(ours)) - true) < 2e-7


def test_at_rest_there_is_no_wave_and_no_number_stays_none():
    assert [float(one) for one in cosine_sine(0.0)] == [1.0, 0.0]
    for odd in (jnp.nan, jnp.inf):
        assert all(np.isnan(one) for one in cosine_sine(odd))


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, np.pi, -2.0, 1e4])
def test_multiples_and_derivatives(angle):
    once = cosine_sine(angle)
    twice = double_angle(*once)
    assert [float(one) for one in twice] == pytest.approx([np.cos(2 * angle), np.sin(2 * angle)], abs=2e-15)
    assert [float(one) for one in triple_angle(*twice)] == pytest.approx(
        [np.cos(6 * angle), np.sin(6 * angle)], abs=1e-14
    )
    slopes = jax.jacfwd(cosine_sine)(angle), jax.jacrev(cosine_sine)(angle)
    for cosine, sine in slopes:
        assert (float(cosine), float(sine)) == (-float(once[1]), float(once[0]))
    bend = jax.jacfwd(jax.jacfwd(cosine_sine))(angle)
    assert [float(one) for one in bend] == [-float(one) for one in once]
