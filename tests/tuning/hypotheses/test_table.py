"""The table of what may act: its evidence is that of Gaussian processes written out, and of larger tables."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.special import logsumexp
from scipy.stats import multivariate_normal

from tuning.diagnosis.gap.dependence import SCALES
from tuning.hypotheses.table import Table

M, K, F, D = 40, 3, 4, 2
rng = np.random.default_rng(3)
JACOBIAN, FUNCTIONS, COLUMNS, RESIDUAL = (rng.normal(size=size) for size in ((M, K), (M, F), (M, D), M))


def fit(jacobian, residual=RESIDUAL, theta=None):
    there = np.zeros(jacobian.shape[1]) if theta is None else theta
    return SimpleNamespace(
        jacobian=jacobian, residual=residual, theta=there, cost=float(residual @ residual + there @ there)
    )


def unlikely(*spread):
    """-2 log probability of the residuals, white but for what is spread along these columns."""
    covariance = np.eye(M) + sum(one @ one.T for one in spread)
    return -2.0 * multivariate_normal(np.zeros(M), covariance).logpdf(RESIDUAL)


def test_its_evidence_is_that_of_functions_of_every_scale_alike():
    table = Table(fit(JACOBIAN), FUNCTIONS)
    gains = [unlikely() - unlikely(JACOBIAN, scale * FUNCTIONS) for scale in SCALES]
    np.testing.assert_allclose(table.alone, gains, rtol=1e-9)
    assert table.evidence == pytest.approx(2.0 * (logsumexp(0.5 * np.array(gains)) - np.log(len(SCALES))))


def test_an_effect_is_worth_what_it_adds_beside_the_functions():
    table = Table(fit(JACOBIAN), FUNCTIONS)
    found = table.of_columns(np.hstack([COLUMNS, 2.0 * COLUMNS[:, :1]]), [slice(0, D), slice(D, D + 1)])
    for (evidence, _, _), columns in zip(found, (COLUMNS, 2.0 * COLUMNS[:, :1]), strict=True):
        gains = [unlikely() - unlikely(JACOBIAN, scale * FUNCTIONS, columns) for scale in SCALES]
        together = 2.0 * (logsumexp(0.5 * np.array(gains)) - np.log(len(SCALES)))
        assert evidence == pytest.approx(together - table.evidence, rel=1e-9)


def test_amounts_and_what_makes_way_are_where_all_together_cost_least():
    theta = rng.normal(size=K)
    table = Table(fit(JACOBIAN, theta=theta), np.zeros((M, 0)))
    ((_, amounts, moved),) = table.of_columns(COLUMNS, [slice(0, D)])
    both = np.hstack([JACOBIAN, COLUMNS])
    slope = both.T @ RESIDUAL + np.r_[theta, np.zeros(D)]
    expected = -np.linalg.solve(both.T @ both + np.eye(K + D), slope)
    np.testing.assert_allclose(np.r_[moved, amounts], expected, rtol=1e-9)


def test_a_change_is_worth_what_a_table_at_the_changed_residuals_is():
    table, other = Table(fit(JACOBIAN), FUNCTIONS), rng.normal(size=M)
    there = fit(JACOBIAN, other)
    evidence, moved = table.of_change(other, there.cost)
    assert evidence == pytest.approx(table.fitted.cost - there.cost + Table(there, FUNCTIONS).evidence - table.evidence)
    assert moved.shape == (K,)


def test_what_functions_can_do_too_is_worth_no_more_beside_them_than_its_fewer_numbers():
    """Each corner costs the logarithm of what the logs narrow it by; the wave has one number for their four."""
    wave = FUNCTIONS @ np.ones((F, 1))
    lacks = RESIDUAL + 30.0 * wave[:, 0]
    alone = Table(fit(JACOBIAN, lacks), np.zeros((M, 0))).of_columns(30.0 * wave, [slice(0, 1)])[0][0]
    beside = Table(fit(JACOBIAN, lacks), 30.0 * FUNCTIONS).of_columns(30.0 * wave, [slice(0, 1)])[0][0]
    assert alone > 1e3
    assert 0.0 < beside < 2.0 * F * np.log(30.0 * np.sqrt(M))
