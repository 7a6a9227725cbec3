"""The sums that a search for a controller's law has of a log: what their blocks say of the memory of what is left."""

import numpy as np
import pytest
from scipy.signal import lfilter

from tuning.identification.controller.moments import BLOCKS, moments
from tuning.identification.controller.signals import Condition, Equation

ROWS = 12_000
LOGS = 40
THETA = np.array([2.0, -1.0, 0.5])


def sums_of(memory, seed, events=None):
    """Of a command with what is left of it; all information is in the first rows, where `events` is less than 1."""
    rng = np.random.default_rng(seed)
    columns = lfilter([1.0], [1.0, -0.9], rng.standard_normal((ROWS, len(THETA))), axis=0)
    if events is not None:
        columns[round(events * ROWS) :] *= 1e-3
    left = lfilter([1.0], [1.0, -memory], rng.standard_normal(ROWS))
    command = (columns @ THETA + left)[:, None]
    found = moments([Equation(columns, command, (Condition(columns, columns, command),))])
    theta, *_ = np.linalg.lstsq(*found.whitened())
    return found, theta[:, 0]


def scatter(memory, events=None):
    """Mean over logs, each with the coefficients that fit it."""
    found = [sums_of(memory, seed, events) for seed in range(LOGS)]
    return np.mean([sums.scatter(np.ones(1), theta) for sums, theta in found])


def test_blocks_of_white_noise_scatter_as_their_noise():
    # 69 squares of normal numbers of each of 40 logs: a deviation of sqrt(2 / 69 / 40) = 0.027
    assert scatter(0.0) == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize("blocks", [2, 3])
def test_few_blocks_with_all_information_scatter_as_their_noise(blocks):
    # three squares to each block but one: a deviation of sqrt(2 / 3 / 40) = 0.13 at most
    assert scatter(0.0, blocks / BLOCKS) == pytest.approx(1.0, abs=0.4)


def test_blocks_of_noise_with_a_memory_scatter_more():
    # the product of two first-order processes remembers with the product of their poles, p: (1 + p) / (1 - p)
    p = 0.9 * 0.8
    assert scatter(0.8) == pytest.approx((1.0 + p) / (1.0 - p), rel=0.1)


def test_blocks_say_nothing_where_one_has_all_information():
    sums, theta = sums_of(0.8, 1, 1.0 / BLOCKS)
    assert sums.scatter(np.ones(1), theta) == 1.0
