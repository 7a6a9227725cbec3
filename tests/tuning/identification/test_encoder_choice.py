"""Whether the answer of both encoders is one that the scale alone permits."""

from typing import NamedTuple

import numpy as np
import pytest

from tuning.identification.encoder_choice import SIGNIFICANCE, permitted
from tuning.identification.estimates import EstimateStatus, ParameterEstimate

ROOT = np.array([[2.0, 0.0, 0.0], [1.5, 0.1, 0.0], [0.0, 0.3, 5.0]])
COVARIANCE = ROOT @ ROOT.T


class Told(NamedTuple):
    estimates: list
    estimate_covariance: np.ndarray


def told(values, covariance=COVARIANCE, status=EstimateStatus.FITTED):
    rows = [
        ParameterEstimate(f"plant.{name}", "N", 0.0, float(value), 0.0, 0.0, 0.0, 0.0, status)
        for name, value in zip("abc", values, strict=False)
    ]
    return Told(rows, covariance)


def test_an_efficient_answer_is_refused_as_rarely_as_it_may_be():
    """Of two answers to the same noise the scale's errs by the other's error and by its own."""
    rng, refused = np.random.default_rng(1), 0
    for _ in range(4000):
        efficient = 0.3 * ROOT @ rng.normal(size=3)
        alone = efficient + np.sqrt(1.0 - 0.3**2) * ROOT @ rng.normal(size=3)
        refused += permitted(told(efficient), told(alone)) < SIGNIFICANCE
    assert refused / 4000 < SIGNIFICANCE


def test_a_distance_along_what_is_well_known_counts_and_along_what_is_not_does_not():
    """The first two are known far better apart than each: their correlation is nearly one."""
    assert permitted(told([0.0, 0.0, 0.0]), told([2.0, 1.5, 0.0])) > 0.5
    assert permitted(told([0.0, 0.0, 0.0]), told([2.0, -1.5, 0.0])) < 1e-6


def test_a_parameter_that_is_a_sum_of_others_counts_once():
    mix = np.vstack([np.eye(3), [1.0, 1.0, 0.0]])
    values = np.array([1.0, -0.5, 2.0])
    with_sum = [
        ParameterEstimate(f"plant.{name}", "N", 0.0, float(value), 0.0, 0.0, 0.0, 0.0, EstimateStatus.FITTED)
        for name, value in zip("abcd", mix @ values, strict=True)
    ]
    nothing = [one._replace(value=0.0) for one in with_sum]
    found = permitted(Told(nothing, np.eye(4)), Told(with_sum, mix @ COVARIANCE @ mix.T))
    assert found == pytest.approx(permitted(told(np.zeros(3)), told(values)), rel=1e-6)


def test_what_one_of_them_does_not_fit_is_not_compared():
    assert permitted(told([9.0, 9.0, 9.0], status=EstimateStatus.UNDETERMINED), told([0.0, 0.0, 0.0])) == 1.0


def test_the_delay_is_that_of_another_encoder_and_no_evidence():
    def late(value):
        rows = [
            ParameterEstimate(path, "1", 0.0, value, 0.0, 0.0, 0.0, 0.0, EstimateStatus.FITTED)
            for path in ("plant.mass", "actuator.delay")
        ]
        return Told([rows[0]._replace(value=1.0), rows[1]], 1e-4 * np.eye(2))

    assert permitted(late(0.0), late(0.05)) == pytest.approx(1.0)


def test_an_estimate_without_an_error_says_nothing_and_is_left_out():
    certain = np.diag([1.0, 0.0, np.nan])
    assert permitted(told([0.0, 0.0, 0.0]), told([0.1, 5.0, 5.0], certain)) > 0.5
    assert permitted(told([0.0, 0.0, 0.0]), told([0.1, 5.0, 5.0], np.zeros((3, 3)))) == 1.0
