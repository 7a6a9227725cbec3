"""The search without a gradient: what it finds on costs whose minimum is known, and when it ends."""

import numpy as np
import pytest

from tuning.optimisation.adaptation import minimum

VALLEY = np.array([0.3, 0.7, 0.55])
USUAL = {"population": 12, "simulations": 3000, "tolerance": 1e-9}


def narrow(shares):
    """A valley a thousand times as narrow one way as another, none of them along an axis."""
    turn = np.linalg.qr(np.array([[1.0, 2.0, 0.5], [0.3, -1.0, 1.0], [1.0, 0.2, -0.7]]))[0]
    return np.sum((((shares - VALLEY) @ turn) * [1.0, 30.0, 1000.0]) ** 2, axis=1)


def test_it_finds_the_end_of_a_narrow_valley_in_any_direction_and_the_same_each_time():
    found = minimum(narrow, np.full(3, 0.5), 0.2, **USUAL)
    np.testing.assert_allclose(found.share, VALLEY, atol=1e-3)
    assert found.cost == pytest.approx(narrow(found.share[None])[0], rel=1e-9)  # summed in another order
    state = np.random.get_state()[1]  # noqa: NPY002  # what it must leave alone
    again = minimum(narrow, np.full(3, 0.5), 0.2, **USUAL)
    np.testing.assert_array_equal(found.share, again.share)
    np.testing.assert_array_equal(np.random.get_state()[1], state)  # noqa: NPY002
    assert np.any(minimum(narrow, np.full(3, 0.5), 0.2, **USUAL, seed=1).share != found.share)


def test_a_minimum_outside_of_the_cube_is_found_on_its_edge():
    found = minimum(lambda shares: np.sum((shares - [1.2, 0.5]) ** 2, axis=1), np.full(2, 0.5), 0.2, **USUAL)
    np.testing.assert_allclose(found.share, [1.0, 0.5], atol=1e-3)


def test_it_ends_with_the_generation_that_passes_the_budget_and_where_nothing_differs_any_more():
    asked = []

    def counted(shares):
        assert np.all((shares >= 0.0) & (shares <= 1.0))
        asked.append(len(shares))
        return narrow(shares)

    found = minimum(counted, np.full(3, 0.5), 0.2, **{**USUAL, "simulations": 100})
    assert found.simulations == sum(asked) == 109  # the start, and nine generations
    early = minimum(narrow, np.full(3, 0.5), 0.2, **{**USUAL, "tolerance": 10.0})
    assert early.simulations < minimum(narrow, np.full(3, 0.5), 0.2, **USUAL).simulations
    assert early.cost < 10.0


def test_it_ends_where_no_target_is_reached_at_its_pace_and_otherwise_changes_nothing():
    """Of a bowl whose bottom is at 1: 0.9 is never reached; 1.001 is, and what is found by then is the same."""

    def bowl(shares):
        return 1.0 + np.sum((shares - VALLEY) ** 2, axis=1)

    usual = minimum(bowl, np.full(3, 0.5), 0.2, **USUAL)
    reached = minimum(bowl, np.full(3, 0.5), 0.2, **USUAL, target=1.001)
    np.testing.assert_array_equal(reached.share, usual.share)
    assert reached.simulations == usual.simulations
    hopeless = minimum(bowl, np.full(3, 0.5), 0.2, **USUAL, target=0.9)
    assert 10 * USUAL["population"] < hopeless.simulations < usual.simulations


@pytest.mark.parametrize("seed", range(3))
def test_a_search_goes_on_while_it_is_on_its_way(seed):
    """From a dip, down a slope that nothing on it is below, to a funnel: no gain for long, and the target at last."""
    start = np.array([0.95, 0.1, 0.1])

    def funnel(shares):
        apart, dip = np.linalg.norm(shares - VALLEY, axis=1), np.all(shares == start, axis=1)
        return np.where(apart < 0.1, 10.0 * apart, 1.0 + 0.3 * apart) - 0.9 * dip

    usual, aimed = (minimum(funnel, start, 0.01, **USUAL, target=target, seed=seed) for target in (np.inf, 0.2))
    assert usual.cost < 0.2
    np.testing.assert_array_equal(aimed.share, usual.share)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_the_worst(bad):
    found = minimum(
        lambda shares: np.where(shares[:, 0] > 0.4, bad, narrow(shares)), np.array([0.9, 0.7, 0.5]), 0.3, **USUAL
    )
    np.testing.assert_allclose(found.share, VALLEY, atol=1e-3)
    nowhere = minimum(lambda shares: np.full(len(shares), bad), np.full(3, 0.5), 0.3, **USUAL)
    np.testing.assert_array_equal(nowhere.share, np.full(3, 0.5))
    assert nowhere.simulations < USUAL["simulations"]
