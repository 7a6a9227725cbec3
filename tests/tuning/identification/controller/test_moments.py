"""The sums that a search for a controller's law has of a log: what their blocks say of the memory of what is left."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tuning.identification.controller.moments import moments
from tuning.identification.controller.signals import Condition, Equation

ROWS = 48_000
THETA = np.array([2.0, -1.0, 0.5])


def equation(left, rng):
    columns = lfilter([1.0], [1.0, -0.9], rng.standard_normal((ROWS, len(THETA))), axis=0)
    command = (columns @ THETA + left)[:, None]
    return Equation(columns, command, (Condition(columns, columns, command),))


def scatter(memory):
    rng = np.random.default_rng(7)
    left = lfilter([1.0], [1.0, -memory], rng.standard_normal(ROWS))
    sums = moments([equation(left, rng)])
    return sums.scatter(np.ones(1), THETA)


def test_blocks_of_white_noise_scatter_as_their_noise():
    # 3 sums of 24 blocks: the mean of 69 squares of normal numbers has a deviation of sqrt(2 / 69) = 0.17
    assert scatter(0.0) == pytest.approx(1.0, abs=0.5)


def test_blocks_of_noise_with_a_memory_scatter_more():
    # the product of two first-order processes remembers with the product of their poles, p: (1 + p) / (1 - p)
    p = 0.9 * 0.8
    assert scatter(0.8) == pytest.approx((1.0 + p) / (1.0 - p), rel=0.5)


def test_a_single_block_tells_nothing():
    one = moments([equation(np.ones(ROWS), np.random.default_rng(1))])
    alone = type(one)(*(part[:1] for part in (one.variances, one.regressors, one.commands)))
    assert alone.scatter(np.ones(1), THETA) == 1.0
