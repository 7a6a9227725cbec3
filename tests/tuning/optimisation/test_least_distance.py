"""The quadratic program: its answers keep the conditions of Karush, Kuhn and Tucker, and it knows contradictions."""

import numpy as np
import pytest
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

from tuning.optimisation.least_distance import quadratic_program


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10_000))
def test_answers_keep_the_conditions_of_optimality(seed):
    rng = np.random.default_rng(seed)
    k, m = rng.integers(1, 9), rng.integers(1, 40)
    root = rng.normal(size=(k + 2, k))
    h, g = 10.0 ** rng.uniform(-3, 3) * root.T @ root, rng.normal(size=k)
    c, b = rng.normal(size=(m, k)), rng.normal(size=m) + 0.5
    solved = quadratic_program(h, g, c, b)
    if solved is None:
        possible = scipy.optimize.linprog(np.zeros(k), A_ub=c, b_ub=b, bounds=[(None, None)] * k)
        assert possible.status == 2
        return
    size = np.max(np.abs(g)) + np.max(np.abs(c.T @ solved.multipliers))
    assert np.all(solved.multipliers >= 0)
    assert np.max(c @ solved.d - b) < 1e-4 * max(1.0, np.max(np.abs(b)))
    assert np.max(np.abs(h @ solved.d + g + c.T @ solved.multipliers)) < 1e-4 * size
    assert np.max(np.abs(solved.multipliers * (c @ solved.d - b))) < 1e-3 * size


def test_without_a_constraint_in_the_way_it_is_newtons_step():
    h, g = np.diag([2.0, 8.0]), np.array([-2.0, 4.0])
    solved = quadratic_program(h, g, np.array([[1.0, 0.0]]), np.array([100.0]))
    np.testing.assert_allclose(solved.d, [1.0, -0.5], rtol=1e-6)
    assert solved.multipliers == pytest.approx([0.0], abs=1e-9)


def test_a_bound_in_the_way_costs_what_the_slope_there_is():
    """min (d - 2)^2 / 2 with d <= 1: the multiplier is 1."""
    solved = quadratic_program(np.eye(1), np.array([-2.0]), np.eye(1), np.ones(1))
    assert solved.d == pytest.approx([1.0])
    assert solved.multipliers == pytest.approx([1.0])


def test_contradictions_have_no_answer():
    assert quadratic_program(np.eye(1), np.zeros(1), np.array([[1.0], [-1.0]]), np.array([-1.0, -1.0])) is None
