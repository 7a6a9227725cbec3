"""The derivative-free baselines on functions with known minima, and the batch of costs against one point at a time."""

import numpy as np
import pytest

from experiments.studies.tuning_study.baselines import (
    FEASIBILITY_TOLERANCE,
    PenalisedCosts,
    cma_es,
    costs_of,
    nelder_mead,
    random_search,
)
from tests.support.small_tuning import small_problem
from tuning.gains.constrained import evaluate
from tuning.optimisation.evolution import DIVERGED_COST, Budget

SEARCHES = [cma_es, nelder_mead, random_search]
LOCAL = [cma_es, nelder_mead]
PLENTY = Budget(20_000, 60.0)
BLOCK = 3  # fewer than the points of a batch
CENTRE = np.array([0.7, -0.4, 1.1])


def free(objective):
    """A cost without requirements."""

    def cost(points):
        found = objective(points)
        return PenalisedCosts(found, found, np.zeros(len(points)))

    return cost


def sphere(points):
    return 1.0 + np.sum((points - CENTRE[: points.shape[1]]) ** 2, axis=1)


def rosenbrock(points):
    x, y = points.T
    return 1.0 + 100.0 * (y - x**2) ** 2 + (1.0 - x) ** 2


def half_plane(points):
    """The sphere about (0.7, -0.4) where x is at most 0.2: the least is 1.25, with a price of 10 per unit missed."""
    missed = np.maximum(points[:, 0] - 0.2, 0.0)
    return PenalisedCosts(sphere(points) + 10.0 * missed, sphere(points), missed)


@pytest.mark.parametrize("search", LOCAL)
def test_the_optimum_of_a_sphere_is_found(search):
    found = search(free(sphere), 3, Budget(1_000, 60.0))
    np.testing.assert_allclose(found.theta, CENTRE, atol=1e-2)
    assert found.cost == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_array_equal(found.feasible, found.theta)


@pytest.mark.parametrize("search", LOCAL)
def test_the_optimum_of_a_curved_valley_is_found(search):
    found = search(free(rosenbrock), 2, PLENTY)
    np.testing.assert_allclose(found.theta, [1.0, 1.0], atol=1e-2)
    assert found.status.startswith("converged: ")
    assert found.simulations < 2_000


def test_random_search_comes_near_the_optimum():
    found = random_search(free(sphere), 2, Budget(4_000, 60.0))
    np.testing.assert_allclose(found.theta, CENTRE[:2], atol=0.2)
    assert found.cost < 1.02


@pytest.mark.parametrize("search", SEARCHES)
def test_requirements_are_kept_at_their_price(search):
    found = search(half_plane, 2, Budget(4_000, 60.0))
    near = 0.2 if search is random_search else 0.02
    np.testing.assert_allclose(found.theta, [0.2, -0.4], atol=near)
    priced = half_plane(found.feasible[None])
    assert priced.violation[0] <= FEASIBILITY_TOLERANCE
    assert priced.objective[0] == found.history[-1].feasible == pytest.approx(1.25, abs=near**2 + 0.01)


@pytest.mark.parametrize("search", SEARCHES)
def test_nothing_is_feasible_where_every_point_misses_something(search):
    found = search(
        lambda points: PenalisedCosts(sphere(points), sphere(points), np.ones(len(points))), 2, Budget(50, 60.0)
    )
    assert found.feasible is None
    assert found.history[-1].feasible == np.inf > found.cost


@pytest.mark.parametrize("search", SEARCHES)
def test_budgets_are_kept_and_counted(search):
    asked = []

    def counted(points):
        asked.append(points)
        return free(sphere)(points)

    found = search(counted, 3, Budget(47, 60.0))
    assert found.simulations == sum(map(len, asked)) == 47
    assert found.status == "stopped after 47 simulations"
    np.testing.assert_array_equal(asked[0], np.zeros((1, 3)))
    costs = sphere(np.concatenate(asked))
    assert found.cost == costs.min() == sphere(found.theta[None])[0]
    assert [visit.cost for visit in found.history] == [costs[: visit.simulations].min() for visit in found.history]
    assert np.all(np.diff([visit.seconds for visit in found.history]) >= 0)


@pytest.mark.parametrize("search", SEARCHES)
def test_a_search_stops_when_its_time_is_up_or_its_cost_good_enough(search):
    late = search(free(sphere), 3, Budget(10**6, 0.0))
    assert (late.status, late.simulations) == ("stopped after 0 s", 1)
    good = search(free(sphere), 3, Budget(10**6, 60.0, 1.5))
    assert good.status == "good enough"
    assert good.cost <= 1.5 < good.history[-2].cost


@pytest.mark.parametrize("search", SEARCHES)
def test_without_a_budget_the_start_is_returned(search):
    found = search(free(sphere), 3, Budget(0, 60.0))
    np.testing.assert_array_equal(found.theta, np.zeros(3))
    assert (found.cost, found.simulations, found.history) == (np.inf, 0, [])


@pytest.mark.parametrize("search", SEARCHES)
def test_seeds_reproduce(search):
    one, same, other = (search(free(sphere), 3, Budget(60, 60.0), seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one.theta, same.theta)
    assert [visit.cost for visit in one.history] == [visit.cost for visit in same.history]
    assert np.any(one.theta != other.theta)


@pytest.mark.parametrize("search", SEARCHES)
def test_an_interrupt_keeps_the_best(search):
    def on_visit(visit):
        if visit.simulations >= 30:
            raise KeyboardInterrupt

    found = search(free(sphere), 3, PLENTY, on_visit=on_visit)
    assert found.status == f"interrupted after {found.simulations} simulations"
    assert 30 <= found.simulations < 50
    assert found.cost == sphere(found.theta[None])[0] < sphere(np.zeros((1, 3)))[0]


@pytest.mark.parametrize("search", SEARCHES)
def test_an_interrupt_of_the_first_simulation_returns_the_start(search):
    def interrupted(points):
        raise KeyboardInterrupt

    found = search(interrupted, 3, PLENTY)
    np.testing.assert_array_equal(found.theta, np.zeros(3))
    assert found.status == "interrupted after 0 simulations"


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_diverges_breaks_nothing(search, value):
    def broken(points):
        lost = points[:, 0] > 1.0
        return PenalisedCosts(*(np.where(lost, value, part) for part in free(sphere)(points)))

    found = search(broken, 3, Budget(500, 60.0))
    assert found.cost < 1.3
    assert found.history[-1].feasible == found.cost


@pytest.mark.parametrize("search", SEARCHES)
def test_where_everything_diverges_the_search_ends_all_the_same(search):
    found = search(free(lambda points: np.full(len(points), np.nan)), 3, Budget(500, 60.0))
    assert found.cost == DIVERGED_COST
    assert found.feasible is None


def test_cma_leaves_no_traces(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    before = np.random.get_state()[1].copy()  # noqa: NPY002 - the global one is what must stay
    cma_es(free(sphere), 3, Budget(200, 60.0))
    np.testing.assert_array_equal(np.random.get_state()[1], before)  # noqa: NPY002
    assert list(tmp_path.iterdir()) == []
    assert capsys.readouterr() == ("", "")


@pytest.fixture(scope="module")
def tiny():
    gains, problem, space = small_problem(name="PD")
    drawn = np.random.default_rng(0).normal(size=(7, len(space.free)))
    points = np.vstack([drawn, np.full(len(space.free), 9.0)])  # the last one is unstable
    return gains, problem, points, [evaluate(gains, y, problem) for y in points]


@pytest.mark.long
@pytest.mark.parametrize("count", [1, 2, 7, 8])
def test_a_batch_costs_what_its_points_cost_one_by_one(tiny, count):
    gains, problem, points, one_by_one = tiny
    found = costs_of(gains, problem, BLOCK)(points[:count])
    for part in PenalisedCosts._fields:
        expected = [float(getattr(point, part)) for point in one_by_one[:count]]
        np.testing.assert_allclose(getattr(found, part), expected, rtol=1e-9, atol=1e-12)
        assert isinstance(getattr(found, part), np.ndarray)


@pytest.mark.long
@pytest.mark.parametrize("search", SEARCHES)
def test_gains_are_searched(tiny, search):
    gains, problem, points, _ = tiny
    found = search(costs_of(gains, problem, BLOCK), points.shape[1], Budget(12, 60.0))
    assert found.simulations == 12
    assert found.cost < found.history[0].cost < 1e3
    assert found.cost == pytest.approx(float(evaluate(gains, found.theta, problem).penalised_objective), rel=1e-9)
