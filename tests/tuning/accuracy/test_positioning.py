"""ISO 230-2: the numbers of deviations, and a motion that measures them."""

import itertools
import statistics

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.errors import ParameterError
from tuning.accuracy.positioning import (
    DWELL,
    RUNS,
    deviations,
    positioning,
    positioning_motion,
    targets_within,
)


def by_the_letter(deviation):
    """The standard's formulas, one target, direction and run after the other."""
    highest, lowest, means, repeated, reversals = [], [], [], [], []
    for target in deviation:
        mean = [statistics.fmean(side) for side in target]
        spread = [statistics.stdev(side) for side in target]
        highest += [x + 2 * s for x, s in zip(mean, spread, strict=True)]
        lowest += [x - 2 * s for x, s in zip(mean, spread, strict=True)]
        means += mean
        reversals.append(abs(mean[0] - mean[1]))
        repeated.append(max(4 * spread[0], 4 * spread[1], 2 * spread[0] + 2 * spread[1] + reversals[-1]))
    return max(highest) - min(lowest), max(means) - min(means), max(repeated), max(reversals)


@given(seed=st.integers(0, 1000))
def test_the_numbers_are_those_of_the_standard(seed):
    deviation = 1e-6 * np.random.default_rng(seed).normal(size=(5, 2, 5))
    assert positioning(deviation) == pytest.approx(by_the_letter(deviation.tolist()), rel=1e-9)


def test_lost_motion_is_the_reversal_error_and_all_else_with_it():
    """Without scatter: every target is reached half of it too soon, from either side."""
    found = positioning(np.tile(np.array([[-2e-6], [2e-6]]), (5, 1, 5)))
    assert found == pytest.approx((4e-6, 4e-6, 4e-6, 4e-6))


def test_the_zero_of_the_measurement_does_not_matter():
    deviation = 1e-6 * np.random.default_rng(1).normal(size=(6, 2, 5))
    assert positioning(deviation + 1e-3) == pytest.approx(positioning(deviation), rel=1e-9)


@pytest.mark.parametrize(
    ("low", "high", "rotary", "count"), [(0, 0.1, False, 5), (-1, 1, False, 10), (0, 1.5, True, 3), (0, 6.0, True, 8)]
)
def test_there_are_enough_targets_and_none_beyond_the_stroke(low, high, rotary, count):
    targets = targets_within(low, high, rotary)
    assert len(targets) == count
    assert np.all((targets > low) & (targets < high) & (np.diff(targets, append=high) > 0))
    assert np.ptp(np.diff(targets)) > 0.1 * (high - low) / count  # no even distance


def test_each_target_is_approached_from_either_side_and_measured_at_rest():
    targets = targets_within(-0.05, 0.05)
    motion, visits = positioning_motion(targets, -0.05, 0.05, 0.2, 2.0, 1_000.0)
    assert np.max(np.abs(motion.velocity)) <= 0.2 * (1 + 1e-9)
    assert np.max(np.abs(motion.acceleration)) <= 2.0 * (1 + 1e-9)
    for target, direction, run in itertools.product(range(5), range(2), range(RUNS)):
        begin = visits.begin[target, direction, run]
        rest = slice(begin, begin + visits.samples)
        assert np.max(np.abs(motion.position[rest] - targets[target])) < 1e-12
        assert np.all(motion.velocity[rest] == 0.0)
        came = motion.velocity[begin - round(DWELL * motion.rate) : begin]
        assert np.sign(came[np.flatnonzero(came)[-1]]) == (1.0, -1.0)[direction]
    assert np.max(np.abs(deviations(motion.position + 3e-6, visits) - 3e-6)) < 1e-12


def test_an_axis_that_is_sampled_too_slowly_is_refused():
    with pytest.raises(ParameterError, match="no sample within"):
        positioning_motion(np.array([0.1]), 0.0, 1.0, 0.1, 1.0, 5.0)
