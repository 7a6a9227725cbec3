"""The smallest set of changes: exact where the mathematics is, and at its level where it is drawn."""

import numpy as np
import pytest

from tuning.comparison.changes import Difference, Estimates

PARAMETERS = ("mass", "coulomb", "coulomb", "viscous", "viscous", "stiffness")
SIZE = len(PARAMETERS)
FREEDOM = 80


def correlated(seed=0):
    rng = np.random.default_rng(seed)
    mixing = rng.normal(size=(SIZE, SIZE))
    matrix = mixing @ mixing.T + 0.3 * np.eye(SIZE)
    scale = np.sqrt(np.diag(matrix))
    return matrix / np.outer(scale, scale)


COVARIANCE = correlated()


def drawn(rng, change, freedom=FREEDOM):
    """Estimates of two sides, their covariances estimated as well: the second is twice as uncertain."""
    root = np.linalg.cholesky(COVARIANCE)

    def side(mean, deviation):
        scatter = deviation * root @ rng.normal(size=(SIZE, freedom))
        return Estimates(mean + deviation * root @ rng.normal(size=SIZE), scatter @ scatter.T / freedom, freedom)

    return Difference(PARAMETERS, side(np.zeros(SIZE), 1.0), side(change, 2.0))


def exact(change, covariance=COVARIANCE, freedom=1e9):
    half = 0.5 * covariance
    return Difference(
        PARAMETERS, Estimates(np.zeros(SIZE), half, freedom), Estimates(np.asarray(change, float), half, freedom)
    )


def swapped(difference):
    return Difference(PARAMETERS, difference.after, difference.before)


CHANGE = np.array([0.0, 30.0, 31.0, 0.0, 0.0, 0.0])


def test_what_is_freed_takes_away_what_least_squares_over_it_would():
    """Against the minimum over the freed changes, by the normal equations."""
    rng = np.random.default_rng(3)
    difference = exact(rng.normal(size=SIZE))
    freed = difference.rows(["coulomb", "stiffness"])
    columns, weight = np.eye(SIZE)[:, freed], np.linalg.inv(COVARIANCE)
    fitted = np.linalg.solve(columns.T @ weight @ columns, columns.T @ weight @ difference.change)
    left = difference.change - columns @ fitted
    assert difference.distance(difference.held(["coulomb", "stiffness"]))[0] == pytest.approx(left @ weight @ left)
    found = difference.intervals(["coulomb", "stiffness"])
    np.testing.assert_allclose([one.value for one in found], fitted)
    widths = 1.959964 * np.sqrt(np.diag(np.linalg.inv(columns.T @ weight @ columns)))
    np.testing.assert_allclose([one.high - one.value for one in found], widths, rtol=1e-4)


def test_the_answer_does_not_hang_on_units():
    scale = np.array([1e-9, 1e6, 1e6, 1.0, 1.0, 1e12])
    one, other = exact(CHANGE), exact(scale * CHANGE, np.outer(scale, scale) * COVARIANCE)
    assert one.explanations(0.01) == other.explanations(0.01)
    assert one.p_unchanged(one.names) == pytest.approx(other.p_unchanged(other.names))
    assert other.smallest("mass", (), 0.01) == pytest.approx(1e-9 * one.smallest("mass", (), 0.01))


def test_one_change_is_named_alone_although_all_estimates_have_moved_with_it():
    """The estimates are correlated: where one parameter has changed, the scatter of the others is not independent."""
    difference = drawn(np.random.default_rng(1), CHANGE)
    assert difference.explanations(0.01) == [("coulomb",)]
    for interval, true in zip(difference.intervals(["coulomb"]), CHANGE[1:3], strict=True):
        assert interval.low < true < interval.high


def test_swapped_sides_have_the_opposite_change():
    difference = drawn(np.random.default_rng(1), CHANGE)
    back = swapped(difference)
    assert back.explanations(0.01) == difference.explanations(0.01)
    for there, here in zip(difference.intervals(["coulomb"]), back.intervals(["coulomb"]), strict=True):
        np.testing.assert_allclose([there.value, there.low, there.high], [-here.value, -here.high, -here.low])


def test_two_changes_are_both_named():
    both = CHANGE + np.array([12.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert drawn(np.random.default_rng(2), both).explanations(0.01)[0] == ("mass", "coulomb")


def test_what_cannot_be_told_apart_is_not_decided():
    """Two parameters whose estimates hardly differ but in their sum: either explains the change."""
    names, nearly = ("mass", "viscous"), np.array([[1.0, 0.9999], [0.9999, 1.0]])
    zero = Estimates(np.zeros(2), 0.5 * nearly, 1e9)
    # what a change of either by 0.05 looks like is not further from that of the other than their scatter
    difference = Difference(names, zero, zero._replace(values=np.array([0.035, -0.035])))
    assert set(difference.explanations(0.01)) == {("mass",), ("viscous",)}


def test_no_change_is_named_as_rarely_as_the_level_says():
    rng, level, count = np.random.default_rng(5), 0.1, 400
    found = [bool(drawn(rng, np.zeros(SIZE), 30).explanations(level)[0]) for _ in range(count)]
    # at most the level, and three standard deviations of the count; and not a test that never speaks
    assert 0.02 < np.mean(found) < level + 3.0 * np.sqrt(level * (1.0 - level) / count)


def test_intervals_hold_the_truth_as_often_as_they_say():
    rng, count = np.random.default_rng(6), 400
    held = []
    for _ in range(count):
        first, second = drawn(rng, CHANGE, 20).intervals(["coulomb"])
        held += [first.low < CHANGE[1] < first.high, second.low < CHANGE[2] < second.high]
    assert np.mean(held) == pytest.approx(0.95, abs=0.025)


def test_the_smallest_change_that_would_be_found_is_found_as_often_as_it_says():
    rng, level, count = np.random.default_rng(7), 0.01, 300
    size = exact(np.zeros(SIZE), 5.0 * COVARIANCE).smallest("coulomb", (), level)  # 1 + 2^2: of both sides
    change = size * np.array([0.0, 1.0, 1.0, 0.0, 0.0, 0.0])
    found = np.mean(["coulomb" in drawn(rng, change, 400).explanations(level)[0] for _ in range(count)])
    assert 0.8 < found < 0.98


def test_nothing_to_compare_is_no_change():
    difference = exact(CHANGE)
    assert difference.p_unchanged(()) == 1.0
    assert difference.p_joint(()) == 1.0
