"""Intervals on linear regressions whose truth is known, and the verdict on residuals whose structure is known."""

from functools import cache

import numpy as np
import pytest
import scipy.signal
import scipy.stats
from hypothesis import given, settings
from hypothesis import strategies as st

from tuning.identification.adequacy import adequacy
from tuning.identification.uncertainty import autocorrelation, correlation_length, sandwich

UNIT_PRIOR = np.eye(3)
RATE, SAMPLES, DRAWS = 1_000.0, 6_000, 200
TRUE = np.array([2.0, -1.0, 0.5])
FRICTION = 100.0  # N


def regressors(rng):
    """Slow columns, as velocity, acceleration and direction of a motion are, and far from a unit prior's reach."""
    columns = scipy.signal.lfilter([1.0], [1.0, -0.95], rng.normal(size=(SAMPLES, 3)), axis=0)
    return columns / np.std(columns, axis=0)


def white(rng, columns):
    return rng.normal(size=SAMPLES)


def coloured(rng, columns):
    """AR(1) that forgets itself after some 20 samples."""
    return scipy.signal.lfilter([1.0], [1.0, -0.95], np.sqrt(1 - 0.95**2) * rng.normal(size=SAMPLES))


def heteroskedastic(rng, columns):
    """Loudest where the first two regressors are large: where most is learnt of their slopes."""
    return rng.normal(size=SAMPLES) * (columns[:, 0] ** 2 + columns[:, 1] ** 2)


def fitted(columns, noise):
    """Least squares: estimates, covariance from `sandwich`, and the textbook's sigma^2 (X'X)^-1."""
    data = columns @ TRUE + noise
    found, *_ = np.linalg.lstsq(columns, data, rcond=None)
    residual = data - columns @ found
    covariance = sandwich(residual[None], -columns[None], RATE, UNIT_PRIOR)
    naive = np.mean(residual**2) * np.linalg.inv(columns.T @ columns)
    return found, covariance, naive


@cache
def drawn(noise_of):
    rng = np.random.default_rng(0)
    columns = regressors(rng)
    return [fitted(columns, noise_of(rng, columns)) for _ in range(DRAWS)]


def covered(draws):
    """Shares of the sandwich's and of the textbook's 95 % intervals that hold the truth."""
    robust, naive = [], []
    for found, covariance, textbook in draws:
        off = np.abs(found - TRUE)
        robust.append(off <= covariance.quantile * np.sqrt(np.diag(covariance.matrix)))
        naive.append(off <= 1.96 * np.sqrt(np.diag(textbook)))
    return np.mean(robust), np.mean(naive)


def test_under_white_noise_it_is_the_textbooks_covariance():
    """In the mean over the draws; up to a third wider, since of two estimates the larger variance counts."""
    draws = drawn(white)
    mean = np.mean([covariance.matrix for _, covariance, _ in draws], axis=0)
    textbook = np.mean([naive for *_, naive in draws], axis=0)
    scale = np.sqrt(np.outer(np.diag(textbook), np.diag(textbook)))
    blocks = draws[0][1].blocks
    assert blocks == SAMPLES // 250
    assert np.max(np.abs(mean - textbook) / scale) < 0.33
    assert np.all(np.diag(mean) >= np.diag(textbook) * (1 - 4 * np.sqrt(2 / blocks / DRAWS)))
    scatter = np.cov([found for found, *_ in draws], rowvar=False)  # and it is what the estimates really do
    assert np.max(np.abs(mean - scatter) / scale) < 0.33 + 4 * np.sqrt(2 / DRAWS)


def test_intervals_cover_under_white_noise():
    robust, naive = covered(drawn(white))
    assert 0.92 < robust < 0.99
    assert 0.92 < naive < 0.98


@pytest.mark.parametrize("noise_of", [coloured, heteroskedastic])
def test_intervals_cover_where_the_textbooks_do_not(noise_of):
    robust, naive = covered(drawn(noise_of))
    assert 0.90 < robust <= 0.99
    assert naive < 0.85


@settings(max_examples=20)
@given(st.lists(st.floats(0.1, 10.0), min_size=3, max_size=3))
def test_a_parameter_in_other_units_has_its_error_in_these_units(units):
    """As long as the data outweigh the unit prior, which is not scaled along."""
    rng = np.random.default_rng(1)
    columns, units = regressors(rng), np.array(units)
    residual = coloured(rng, columns)
    plain, scaled = (sandwich(residual[None], each[None], RATE, UNIT_PRIOR) for each in (columns, columns / units))
    expected = plain.matrix * np.outer(units, units)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.max(np.abs(scaled.matrix - expected) / scale) < 0.1
    assert scaled.blocks == plain.blocks


def test_the_order_of_the_lanes_does_not_matter_nor_do_lanes_of_padding():
    rng = np.random.default_rng(2)
    columns = np.stack([regressors(rng) for _ in range(3)])
    residual = rng.normal(size=columns.shape[:2])
    plain = sandwich(residual, columns, RATE, UNIT_PRIOR)
    swapped = sandwich(residual[::-1], columns[::-1], RATE, UNIT_PRIOR)
    padded = sandwich(
        np.vstack([residual, 0 * residual[:1]]), np.concatenate([columns, 0 * columns[:1]]), RATE, UNIT_PRIOR
    )
    np.testing.assert_allclose(swapped.matrix, plain.matrix, rtol=1e-9, atol=1e-20)
    np.testing.assert_allclose(padded.matrix, plain.matrix, rtol=1e-9, atol=1e-20)
    assert padded.blocks == plain.blocks


@pytest.mark.parametrize("apart", [1e-3, 1e-6, 1e-9, 0.0])
def test_columns_that_are_nearly_one_stay_finite_and_are_told_correlated(apart):
    rng = np.random.default_rng(3)
    columns = regressors(rng)
    columns[:, 1] = columns[:, 0] + apart * columns[:, 1]
    found = sandwich(white(rng, columns)[None], columns[None], RATE, UNIT_PRIOR)
    assert np.all(np.isfinite(found.matrix))
    assert np.all(np.linalg.eigvalsh(found.matrix) > -1e-12)
    assert np.isfinite(found.condition)
    errors = np.sqrt(np.diag(found.matrix))
    assert found.correlation[0, 1] < -0.99
    assert errors[2] < 0.05 < errors[0]
    assert errors[0] < 2.0  # no more than the prior leaves open


def test_a_parameter_of_which_the_data_say_nothing_keeps_the_error_of_its_prior():
    rng = np.random.default_rng(4)
    columns = regressors(rng)
    columns[:, 1] = 0.0
    residual = white(rng, columns)[None]
    errors = np.sqrt(np.diag(sandwich(residual, columns[None], RATE, UNIT_PRIOR).matrix))
    assert errors[1] == pytest.approx(1.0, rel=1e-9)
    assert max(errors[0], errors[2]) < 0.05
    weak = np.array([1.0, 0.02, 1.0])
    assert sandwich(residual, columns[None], RATE, np.diag(weak)).matrix[1, 1] == pytest.approx(50.0**2, rel=1e-9)


def test_the_autocorrelation_of_an_autoregression_is_its_coefficients_powers():
    rng = np.random.default_rng(5)
    series = scipy.signal.lfilter([1.0], [1.0, -0.8], rng.normal(size=(2, 200_000)), axis=1)
    np.testing.assert_allclose(autocorrelation(series, 10), 0.8 ** np.arange(1, 11), atol=0.02)
    naive = [np.sum(series[:, lag:] * series[:, :-lag]) / np.sum(series**2) for lag in range(1, 4)]
    np.testing.assert_allclose(autocorrelation(series, 3), naive, rtol=1e-9)
    assert 10 < correlation_length(series) < 40  # 0.8^17 is 0.02
    assert correlation_length(rng.normal(size=(1, 50_000))) < 5


NOTHING = np.zeros((1, 20_000))


def judged(innovation, gain=0.0, force=0.0):
    return adequacy(innovation, gain, np.full(innovation.shape, force), FRICTION)


def autoregression(predictable, seed):
    """White noise through 1 / (1 - a q^-1): the share a^2 of its variance is predictable from its past."""
    rng = np.random.default_rng(seed)
    return scipy.signal.lfilter([1.0], [1.0, -np.sqrt(predictable)], rng.normal(size=NOTHING.shape), axis=1)


def test_a_log_too_short_to_judge_is_not_said_to_miss_nothing():
    innovation = np.random.default_rng(6).normal(size=NOTHING.shape)
    verdict = judged(innovation, gain=1e6, force=np.nan)
    assert verdict.has_structure
    assert "too short" in verdict.says
    partly = np.where(np.arange(NOTHING.shape[1]) < 15_000, np.nan, 3.0)[None]
    assert adequacy(innovation, 1e6, partly, FRICTION).missing == pytest.approx(3.0)


@pytest.mark.parametrize("seed", range(5))
def test_white_innovations_and_no_missing_force_are_no_structure(seed):
    verdict = judged(np.random.default_rng(seed).normal(size=NOTHING.shape), gain=5.0, force=0.05)
    assert not verdict.has_structure
    assert verdict.p_value > 1e-3
    assert verdict.predictable < 0.005
    assert verdict.says.startswith("nothing is missing")


def test_the_p_value_of_white_innovations_is_uniform():
    rng = np.random.default_rng(6)
    values = [judged(rng.normal(size=(1, 2_000))).p_value for _ in range(100)]
    assert scipy.stats.kstest(values, "uniform").pvalue > 0.01


@pytest.mark.parametrize("predictable", [0.02, 0.05, 0.5])
def test_innovations_that_their_past_predicts_are_structure(predictable):
    verdict = judged(autoregression(predictable, 7))
    assert verdict.has_structure
    assert verdict.predictable == pytest.approx(predictable, abs=0.01)
    assert verdict.p_value < 1e-3
    assert f"{100 * verdict.predictable:.2g} %" in verdict.says


def test_a_trace_of_colour_is_beyond_doubt_and_yet_too_small_to_matter():
    verdict = judged(autoregression(0.005, 8))
    assert verdict.p_value < 1e-3
    assert not verdict.has_structure


@pytest.mark.parametrize(("gain", "force", "structured"), [(500.0, 3.0, True), (500.0, 0.01, False), (3.0, 3.0, False)])
def test_a_force_is_missing_where_it_is_both_certain_and_large(gain, force, structured):
    verdict = judged(np.random.default_rng(9).normal(size=NOTHING.shape), gain, force)
    assert verdict.has_structure is structured
    assert verdict.missing == pytest.approx(force)
    assert verdict.share == pytest.approx(force / FRICTION)
    assert f"{force:.2g} N" in verdict.says
    assert f"{100 * force / FRICTION:.2g} %" in verdict.says
    assert verdict.says.startswith("the model does not explain the logs") is structured


def test_the_padding_of_short_stretches_does_not_count():
    rng = np.random.default_rng(10)
    innovation = rng.normal(size=(2, 10_000))
    force = np.full(innovation.shape, 3.0)
    innovation[1, 5_000:], force[1, 5_000:] = 0.0, 0.0
    verdict = adequacy(innovation, 500.0, force, FRICTION)
    assert verdict.missing == pytest.approx(3.0)
    assert verdict.p_value > 1e-3


def test_a_derivative_that_has_run_away_does_not_overflow():
    """As it does where a search passes through a model that diverges: that parameter is known beyond measure."""
    rng = np.random.default_rng(11)
    columns = regressors(rng)
    residual = white(rng, columns)
    plain = sandwich(residual[None], columns[None], RATE, UNIT_PRIOR)
    wild = sandwich(residual[None], columns[None] * np.array([1.0, 1e200, 1.0]), RATE, UNIT_PRIOR)
    kept = np.ix_([0, 2], [0, 2])
    np.testing.assert_allclose(wild.matrix[kept], plain.matrix[kept], rtol=1e-3)
    assert 0.0 <= wild.matrix[1, 1] < 1e-300
