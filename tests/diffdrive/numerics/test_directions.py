"""Derivatives in many directions side by side."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.numerics.directions import WHOLE, along_each


def values(theta):
    return jnp.stack([jnp.sin(theta).sum() * theta, jnp.cos(theta) ** 2]), jnp.exp(theta.sum())


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("size", [1, 7, 8, 13])
def test_they_are_those_of_one_after_the_other(size, axis):
    at = jnp.asarray(np.random.default_rng(size).normal(size=size))
    value, columns = along_each(lambda theta: values(theta)[0], at, axis)
    np.testing.assert_array_equal(value, values(at)[0])
    np.testing.assert_allclose(jnp.moveaxis(columns, axis, -1), jax.jacfwd(values)(at)[0], rtol=1e-14)


def test_a_tree_of_values_has_a_tree_of_derivatives_in_every_direction():
    (_, exponential), (slopes, slope) = along_each(values, jnp.zeros(3), 0)
    assert slopes.shape == (3, 2, 3)
    np.testing.assert_allclose(slope, 3 * [float(exponential)], rtol=1e-14)


def test_what_is_filled_up_is_whole_vectors():
    """Thirteen directions are worked out as sixteen."""
    shapes = [
        one.aval.shape
        for equation in jax.make_jaxpr(lambda at: along_each(lambda x: x * x, at, 0))(jnp.ones(13)).eqns
        for one in equation.outvars
    ]
    assert (2 * WHOLE, 13) in shapes
