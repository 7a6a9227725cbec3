"""The search space, and the least-squares search."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.controllers.base import PDGains
from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.model.parameters import Plant
from diffdrive.numerics.arrays import as_arrays
from tuning.optimisation.least_squares import Outcome, levenberg_marquardt, relative_offset
from tuning.optimisation.space import FreeParameter, search_space, space_around


@given(st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_no_point_of_a_space_leaves_its_bounds(y):
    plant = Plant(mass=100.0, damping=(380.0, 260.0), constant_force=2.0)
    bounds = (
        FreeParameter("mass", 50.0, 300.0),
        FreeParameter("constant_force", -5.0, 5.0),
        FreeParameter("damping.negative", 1.0, 1e3),
    )
    space = search_space(plant, bounds)
    values = np.asarray(space.values(np.array(y)))
    for value, (_, low, high) in zip(values, bounds, strict=True):
        assert low * (1 - 1e-12) <= value <= high * (1 + 1e-12) or low <= value <= high


def test_the_origin_of_a_space_is_the_model_it_was_made_from():
    plant = Plant(mass=100.0, damping=(380.0, 260.0), constant_force=2.0)
    space = search_space(plant, [FreeParameter("mass", 50.0, 300.0), FreeParameter("constant_force", -5.0, 5.0)])
    again = space.insert(as_arrays(plant), np.zeros(2))
    np.testing.assert_allclose([again.mass, again.constant_force], [100.0, 2.0], rtol=1e-12)
    np.testing.assert_array_equal([again.damping.positive, again.damping.negative], [380.0, 260.0])


def test_a_parameter_per_direction_moves_in_both_or_in_one():
    plant = Plant(mass=100.0, damping=(300.0, 300.0))
    both = search_space(plant, [FreeParameter("damping", 1.0, 1e3)]).insert(as_arrays(plant), np.ones(1))
    one = search_space(plant, [FreeParameter("damping.negative", 1.0, 1e3)]).insert(as_arrays(plant), np.ones(1))
    assert both.damping.positive == both.damping.negative > 300.0
    assert one.damping.positive == 300.0 < one.damping.negative


def test_parameters_near_their_bounds_are_named():
    space = space_around(PDGains(1e6, 1e3), {"kp": 2.0, "kd": 2.0})
    assert space.near_bound(np.array([0.0, 0.0])) == []
    assert space.near_bound(np.array([9.0, -9.0])) == ["kp", "kd"]


def test_directions_that_differ_are_not_moved_as_one():
    with pytest.raises(ParameterError, match=r"free 'damping\.positive' and 'damping\.negative'"):
        search_space(Plant(mass=100.0, damping=(380.0, 260.0)), [FreeParameter("damping", 1.0, 1e3)])


@pytest.mark.parametrize(
    ("bounds", "says"),
    [
        (FreeParameter("kq", 1.0, 2.0), "no parameter 'kq'.*known: .*kp"),
        (FreeParameter("kp", 1.0, 2.0), "not inside its bounds.*widen"),
    ],
)
def test_impossible_spaces_are_refused(bounds, says):
    with pytest.raises(ParameterError, match=says):
        search_space(PDGains(1e6, 1e3), [bounds])


def test_a_parameter_that_is_zero_stays_zero():
    assert space_around(PDGains(1e6, 0.0), {"kp": 2.0, "kd": 2.0}).names == ["kp"]


def search_rosenbrock(**settings):
    return levenberg_marquardt(
        lambda y, a: jnp.stack([a * (y[1] - y[0] ** 2), 1.0 - y[0]]),
        np.array([-1.2, 1.0]),
        jnp.asarray(10.0),
        tolerance=1e-8,
        **settings,
    )


def test_least_squares_finds_the_minimum_of_rosenbrock():
    seen = []
    found = search_rosenbrock(
        max_steps=100,
        progress=lambda step, most, cost: seen.append((step, cost)),
    )
    np.testing.assert_allclose(found.theta, [1.0, 1.0], atol=1e-6)
    assert (found.outcome, found.status) == (Outcome.CONVERGED, "converged")
    assert [step for step, _ in seen] == list(range(1, found.steps + 1))
    assert np.all(np.diff([cost for _, cost in seen]) <= 0)


def test_a_search_that_runs_out_of_steps_says_so_and_returns_its_best():
    found = search_rosenbrock(
        max_steps=3,
    )
    assert (found.outcome, found.status) == (Outcome.STOPPED, "stopped after 3 steps, still falling")
    assert found.cost == min(found.history) <= found.initial_cost


def test_an_interrupted_search_returns_the_best_it_has_seen():
    def progress(step, most, cost):
        if step == 3:
            raise KeyboardInterrupt

    found = search_rosenbrock(
        max_steps=100,
        progress=progress,
    )
    assert (found.outcome, found.status) == (Outcome.INTERRUPTED, "interrupted after 2 steps")
    assert found.cost == min(found.history) < found.initial_cost


def bent(y, times):
    """Residuals of a curve that no choice of its three numbers fits."""
    return y[0] * jnp.exp(-y[1] * times) + y[2] * times - jnp.cos(3.0 * times)


def test_the_relative_offset_is_the_distance_from_the_minimum_in_standard_errors():
    random = np.random.default_rng(3)
    slope, data = random.normal(size=(50, 4)) * [1.0, 1e-2, 1e2, 1.0], random.normal(size=50)
    best, rest = np.linalg.lstsq(slope, data)[:2]
    scatter = np.sqrt(rest[0] / 46)
    errors = scatter * np.sqrt(np.diag(np.linalg.inv(slope.T @ slope)))
    for shift in random.normal(size=(5, 4)) * 1e-2:
        point = best + errors * shift
        offset = float(relative_offset(jnp.asarray(slope @ point - data), jnp.asarray(slope)))
        assert 2.0 * offset == pytest.approx(np.linalg.norm(slope @ (errors * shift)) / scatter, rel=1e-6)
        assert 2.0 * offset >= np.max(np.abs(shift)) * (1 - 1e-9)
    assert float(relative_offset(jnp.asarray(data[:4]), jnp.asarray(slope[:4]))) == np.inf
    without_effect = slope * [1.0, 0.0, 1.0, 1.0]
    assert not float(relative_offset(jnp.asarray(data), jnp.asarray(without_effect))) < 1.0


def test_a_search_that_begins_at_the_minimum_ends_there():
    times = jnp.linspace(0.0, 2.0, 40)
    settings = {"max_steps": 50, "tolerance": 0.0, "min_gain": 0.0, "min_offset": 1e-3}
    first = levenberg_marquardt(bent, np.array([3.0, -2.0, 1.0]), times, **settings)
    again = levenberg_marquardt(bent, first.theta, times, **settings)
    assert first.outcome is again.outcome is Outcome.CONVERGED
    assert 1 == again.steps < first.steps < 50
    np.testing.assert_array_equal(again.theta, first.theta)


def test_a_search_from_a_diverging_start_is_refused():
    with pytest.raises(DivergenceError, match="diverges where the search starts"):
        levenberg_marquardt(lambda y, _: jnp.log(y), np.array([-1.0]), None, max_steps=3, tolerance=1e-3)
