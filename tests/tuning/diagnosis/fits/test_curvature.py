"""Equations in a curvature are solved where its prior is lost in rounding."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tuning.diagnosis.fits.curvature import FARTHEST, limited, log_volume, solved


@given(st.integers(1, 12), st.integers(0, 2**32 - 1), st.sampled_from([(), (3,)]))
def test_it_is_the_least_squares_solution_with_the_prior_as_observations(size, seed, more):
    rng = np.random.default_rng(seed)
    jacobian = rng.normal(size=(40, size)) * 10.0 ** rng.uniform(-3, 3, size)
    right = rng.normal(size=(size, *more))
    stacked = np.vstack([jacobian, np.eye(size)])
    r = np.linalg.qr(stacked, mode="r")
    expected = np.linalg.solve(r, np.linalg.solve(r.T, right))
    found = solved(jacobian.T @ jacobian + np.eye(size), right)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-7 * np.abs(expected).max())


def test_what_two_directions_share_a_billion_times_better_leaves_the_prior_between_them():
    jacobian = 1e9 * np.array([[1.0, 1.0]])
    curvature = jacobian.T @ jacobian + np.eye(2)
    assert np.linalg.matrix_rank(curvature) == 1
    variance = np.diag(solved(curvature, np.eye(2)))
    np.testing.assert_allclose(variance, 0.5, rtol=1e-6)  # of the difference one, of the sum none


def test_what_is_not_finite_has_no_solution():
    assert np.all(np.isnan(solved(np.array([[1.0, np.nan], [np.nan, 1.0]]), np.ones(2))))
    assert np.all(np.isnan(solved(np.eye(2), np.array([np.inf, 1.0]))))


def test_a_step_keeps_its_direction_and_leads_no_further_than_a_prior_could_mean():
    small = np.array([0.5, -FARTHEST])
    np.testing.assert_array_equal(limited(small), small)
    far = np.array([1.0, -40.0, 0.0]) * FARTHEST
    np.testing.assert_allclose(limited(far), far / 40.0)
    assert limited(np.zeros(0)).size == 0


def test_a_volume_is_that_of_the_curvature_and_never_more_than_the_priors():
    rng = np.random.default_rng(3)
    jacobian = rng.normal(size=(40, 5))
    curvature = jacobian.T @ jacobian + np.eye(5)
    np.testing.assert_allclose(log_volume(curvature), np.linalg.slogdet(curvature)[1])
    shared = 1e8 * np.array([[1.0, 1.0]])  # the prior between the two is lost in rounding
    np.testing.assert_allclose(log_volume(shared.T @ shared + np.eye(2)), np.log(2e16), rtol=1e-6)
    assert np.isnan(log_volume(np.full((2, 2), np.nan)))
