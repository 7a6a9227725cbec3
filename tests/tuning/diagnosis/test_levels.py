"""The levels of the diagnosis follow from what they are said to follow from."""

import numpy as np
import pytest
from scipy.stats import chi2

from tuning.diagnosis.hypotheses.catalogue import CATALOGUE
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.diagnosis.levels import BLOWS, CHANCE, COLDEST, DECLARED, LACKING, TESTED, WORTH

SETTING = Setting(100.0, 70.0, 4e-4, 2e3, 0.0, 3e-6, 5e-4, 9.0, -0.02, 0.02, 0.06, 200.0, 200.0)


def test_two_forces_gain_by_chance_what_counts_as_missing_once_in_a_million():
    assert chi2.sf(LACKING, 2) == pytest.approx(CHANCE)


def test_a_sample_at_which_the_filter_is_lost_is_missing_by_itself():
    assert BLOWS > LACKING


def test_by_chance_one_of_all_effects_brings_what_it_must_as_seldom_as_a_rival_is_no_longer_declared():
    """Markov: evidence of twice the logarithm of 1 / p comes with a chance of p at most."""
    names = {make(SETTING).name for make in CATALOGUE}
    assert len(names) == TESTED
    assert TESTED * np.exp(-0.5 * WORTH) == pytest.approx(DECLARED)


def test_a_rival_that_lacks_what_counts_as_missing_is_not_declared():
    assert np.exp(-LACKING / COLDEST) == pytest.approx(DECLARED)
