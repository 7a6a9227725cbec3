"""The step's own exp(-x) against the exact one."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.exponential import FARTHEST, FARTHEST_SINGLE, fading

COMPILED = jax.jit(fading)


@given(st.floats(0.0, FARTHEST))
def test_it_is_the_exponential_to_rounding(x):
    exact = np.exp(-np.longdouble(x))
    assert abs(np.longdouble(float(COMPILED(x))) - exact) <= 4e-16 * exact


def test_it_is_so_where_the_power_of_two_changes():
    edges = (np.arange(1000) + 0.5) * np.log(2.0)
    x = np.concatenate([np.nextafter(edges, 0.0), edges, np.nextafter(edges, 1e3)])
    exact = np.exp(-x.astype(np.longdouble))
    assert np.max(np.abs(np.asarray(COMPILED(x)) / exact - 1)) < 4e-16


def test_its_ends():
    assert float(fading(0.0)) == 1.0
    assert float(fading(-0.0)) == 1.0
    assert 0.0 < float(fading(jnp.inf)) < 1e-300
    assert np.isnan(fading(jnp.nan))
    assert float(fading(5e-324)) == 1.0


@given(st.floats(0.0, FARTHEST_SINGLE, width=32))
def test_of_a_float_it_is_the_exponential_of_a_float(x):
    found, exact = COMPILED(jnp.float32(x)), np.exp(-np.longdouble(x))
    assert found.dtype == jnp.float32
    assert abs(np.longdouble(float(found)) - exact) <= 2.5e-7 * exact
    assert float(jax.grad(fading)(jnp.float32(x))) == -float(fading(jnp.float32(x)))


@pytest.mark.parametrize("x", [0.0, 1e-9, 0.3, np.log(2.0) / 2, 40.0])
def test_its_derivatives_are_itself_by_turns(x):
    slope, bend = jax.grad(fading), jax.grad(jax.grad(fading))
    assert float(slope(x)) == -float(fading(x))
    assert float(bend(x)) == float(fading(x))
    assert float(jax.jvp(fading, (x,), (2.0,))[1]) == -2.0 * float(fading(x))
