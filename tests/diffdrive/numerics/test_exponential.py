"""The step's own exp(-x) and 2^-y against the exact ones."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.numerics.exponential import (
    LN2,
    LOG2_E,
    MAX_ARGUMENT,
    MAX_ARGUMENT_SINGLE,
    bounded_power,
    exp2_neg,
    exp_neg,
    exp_neg_parts,
)

COMPILED, HALVED = jax.jit(exp_neg), jax.jit(exp2_neg)


@given(st.floats(0.0, MAX_ARGUMENT))
def test_it_is_the_exponential_to_rounding(x):
    exact = np.exp(-np.longdouble(x))
    assert abs(np.longdouble(float(COMPILED(x))) - exact) <= 4e-16 * exact


def test_it_is_so_where_the_power_of_two_changes():
    edges = (np.arange(960) + 0.5) * np.log(2.0)
    x = np.concatenate([np.nextafter(edges, 0.0), edges, np.nextafter(edges, 1e3)])
    exact = np.exp(-x.astype(np.longdouble))
    assert np.max(np.abs(np.asarray(COMPILED(x)) / exact - 1)) < 4e-16


@given(st.floats(0.0, MAX_ARGUMENT * LOG2_E))
def test_a_power_of_two_is_so_too(y):
    exact = np.exp2(-np.longdouble(y))
    assert abs(np.longdouble(float(HALVED(y))) - exact) <= 4e-16 * exact


def test_halving_is_right_where_the_whole_number_changes():
    edges = np.arange(960) + 0.5
    y = np.concatenate([np.nextafter(edges, 0.0), edges, np.nextafter(edges, 1e4)])
    assert np.max(np.abs(np.asarray(HALVED(y)) / np.exp2(-y.astype(np.longdouble)) - 1)) < 4e-16
    whole = np.arange(960.0)
    np.testing.assert_array_equal(HALVED(whole), np.exp2(-whole))


@pytest.mark.parametrize("function", [exp_neg, exp2_neg])
def test_its_ends(function):
    assert float(function(0.0)) == 1.0
    assert float(function(-0.0)) == 1.0
    assert 0.0 < float(function(jnp.inf)) < 1e-290
    assert 0.0 < float(function(1e5)) < 1e-290
    assert np.isnan(function(jnp.nan))
    assert float(function(5e-324)) == 1.0


@given(st.floats(0.0, 0.34))
def test_the_series_is_what_the_exponential_lacks_of_a_line(x):
    told = exp_neg_parts(jnp.asarray(x))
    assert bool(told.small)
    terms = [(-np.longdouble(x)) ** k / math.factorial(k + 2) for k in range(25)]
    assert float(told.series) == pytest.approx(float(sum(terms)), rel=4e-16)


def test_the_series_is_told_below_half_a_halving():
    assert bool(exp_neg_parts(0.49 * LN2).small)
    assert not bool(exp_neg_parts(0.51 * LN2).small)


@given(st.floats(0.0, MAX_ARGUMENT_SINGLE, width=32))
def test_of_a_float_it_is_the_exponential_of_a_float(x):
    found, exact = COMPILED(jnp.float32(x)), np.exp(-np.longdouble(x))
    assert found.dtype == jnp.float32
    assert abs(np.longdouble(float(found)) - exact) <= 2.5e-7 * exact
    assert float(jax.grad(exp_neg)(jnp.float32(x))) == -float(exp_neg(jnp.float32(x)))
    found, exact = HALVED(jnp.float32(x)), np.exp2(-np.longdouble(x))
    assert found.dtype == jnp.float32
    assert abs(np.longdouble(float(found)) - exact) <= 2.5e-7 * exact


@pytest.mark.parametrize("x", [0.0, 1e-9, 0.3, np.log(2.0) / 2, 40.0])
def test_its_derivatives_are_itself_by_turns(x):
    slope, bend = jax.grad(exp_neg), jax.grad(jax.grad(exp_neg))
    assert float(slope(x)) == -float(exp_neg(x))
    assert float(bend(x)) == float(exp_neg(x))
    assert float(jax.jvp(exp_neg, (x,), (2.0,))[1]) == -2.0 * float(exp_neg(x))
    slope, bend = jax.grad(exp2_neg), jax.grad(jax.grad(exp2_neg))
    assert float(slope(x)) == -LN2 * float(exp2_neg(x))
    assert float(bend(x)) == pytest.approx(LN2**2 * float(exp2_neg(x)), rel=1e-15)


@pytest.mark.parametrize("power", [0.1, 0.5, 1.0, 1.7, 2.0, 4.0])
def test_a_power_is_right_to_rounding_and_so_are_its_slopes(power):
    bases = np.r_[
        1e-11, np.geomspace(1e-9, 1e5, 4001), np.sqrt(0.5), 1.0, np.nextafter(np.sqrt(2.0), 0.0), np.sqrt(2.0)
    ]
    exact = bases**power
    counted = exact < 2.0**40
    found = np.asarray(jax.vmap(bounded_power, (0, None))(bases, power))
    np.testing.assert_allclose(found, np.minimum(exact, 2.0**40), rtol=3e-14)
    by_base, by_power = jax.vmap(jax.grad(bounded_power, (0, 1)), (0, None))(bases, power)
    np.testing.assert_allclose(by_base, np.where(counted, power * exact / bases, 0.0), rtol=1e-13)
    np.testing.assert_allclose(by_power, np.where(counted, exact * np.log(bases), 0.0), rtol=1e-12, atol=1e-300)


def test_a_power_in_single_precision_nothing_and_no_number():
    bases = np.geomspace(1e-9, 1e3, 2001).astype(np.float32)
    found = jax.vmap(bounded_power, (0, None))(bases, np.float32(1.5))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, bases.astype(float) ** 1.5, rtol=4e-6)
    assert float(bounded_power(0.0, 0.5)) == 0.0
    assert np.isnan(float(bounded_power(np.nan, 2.0)))
    assert float(bounded_power(np.inf, 2.0)) == 2.0**40
    assert jax.hessian(bounded_power)(0.3, 1.7) == pytest.approx(1.7 * 0.7 * 0.3**-0.3)
