"""Confidence that is learned from answers: right probabilities are recovered, and judged where they were not fitted."""

import glob
from pathlib import Path

import numpy as np
from scipy.special import expit

from experiments.studies.learned_confidence import (
    Causes,
    fitted_logistic,
    judged_elsewhere,
    log_loss,
    read_causes,
    table,
)

STUDIES = sorted(glob.glob(str(Path(__file__).parents[3] / "docs/evidence/withheld-seed-*.zip")))


def drawn(count, seed=1):
    """Causes that act with a known probability, of which one number of two tells."""
    random = np.random.default_rng(seed)
    numbers = np.column_stack([3.0 + 2.0 * random.normal(size=count), random.normal(size=count)])
    probability = expit(1.0 + 1.5 * (numbers[:, 0] - 3.0))
    acts = random.uniform(size=count) < probability
    return Causes(numbers, probability, np.zeros(count, bool), acts, np.arange(count) % 5), probability


def test_probabilities_that_are_logistic_are_recovered():
    causes, probability = drawn(20_000)
    found = fitted_logistic(causes.numbers, causes.acts)(causes.numbers)
    assert np.abs(found - probability).max() < 0.03


def test_what_tells_nothing_is_not_learned():
    """Judged where it was not fitted, noise cannot be better than the share of those that act."""
    causes, _ = drawn(600)
    noise = np.random.default_rng(2).normal(size=(600, 10))
    share = np.full(600, causes.acts.mean())
    assert log_loss(judged_elsewhere(causes, noise), causes.acts) > log_loss(share, causes.acts) - 1e-3


def test_a_sure_and_right_answer_costs_nothing_and_a_sure_and_wrong_one_much():
    assert log_loss(np.array([0.5, 0.5]), np.array([True, False])) == np.log(2.0)
    assert log_loss(np.array([0.99]), np.array([True])) < 0.011 < 4.6 < log_loss(np.array([0.99]), np.array([False]))


def test_the_stored_studies_are_read():
    causes = read_causes([Path(name) for name in STUDIES[:2]])
    assert causes.numbers.shape == (len(causes.acts), 13)
    assert np.all(np.isfinite(causes.numbers))
    assert 200 < len(causes.acts) < 300
    assert set(causes.study) == {0, 1}
    assert "| the diagnosis's own |" in table(causes)
