"""What a controller is tuned for: parts, aggregations, and the squares that have the same gradient."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import tuning
from diffdrive.errors import MotionError, ParameterError
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import paper_drive
from diffdrive.motion.builders import triangular
from diffdrive.numerics.arrays import as_arrays
from tests.support.small_tuning import MOTION, SAMPLING, controller, drive, lanes, scenarios
from tuning.gains.objective import AGGREGATIONS, Objective, mean, peak, rms
from tuning.gains.scenarios import EnsembleSignals, Scenario, ensemble


def made_up(seed, lanes=5, n=200):
    rng = np.random.default_rng(seed)
    error, change, missed = (
        jnp.asarray(rng.normal(size=(lanes, n)) * rng.uniform(0.1, 3.0, (lanes, 1))) for _ in range(3)
    )
    return EnsembleSignals(1e-8 * error, change, None, 100.0 * missed)


OBJECTIVES = [
    Objective(),
    Objective(peak=5e5),
    Objective(load_error=1e-5),
    Objective(peak=1e6, load_error=1e-4, aggregation="worst"),
    Objective(load_error=1e-5, aggregation="cvar"),
]


@pytest.mark.parametrize("objective", OBJECTIVES, ids=lambda one: f"{one.aggregation} {one.peak:g} {one.load_error:g}")
def test_the_weighed_squares_have_the_gradient_of_the_objective(objective):
    signals = made_up(1)
    weights = objective.weights(signals)

    def half_square(signals):
        parts = jax.tree.map(lambda weight, signal: jnp.sum((weight * signal) ** 2), weights, signals)
        return 0.5 * sum(jax.tree.leaves(parts))

    ours, theirs = jax.grad(half_square)(signals), jax.grad(objective)(signals)
    for one, other in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12 * float(jnp.max(jnp.abs(other)) + 1e-300))


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(1e-3, 1e3), min_size=4, max_size=12))
def test_aggregations_lie_between_the_mean_and_the_worst(costs):
    costs = jnp.asarray(costs)
    mean, worst, cvar = (float(AGGREGATIONS[name](costs)) for name in ("mean", "worst", "cvar"))
    largest, average = float(jnp.max(costs)), float(jnp.mean(costs))
    assert mean == pytest.approx(average)
    assert average - 1e-12 <= cvar <= largest * (1 + 1e-12)
    assert largest * (1 - 1e-9) <= worst <= largest + average / 20.0 * np.log(len(costs)) + 1e-9


def test_the_smooth_peak_is_just_above_the_largest():
    signal = made_up(2).error
    largest = np.max(np.abs(signal), axis=1)
    found = np.asarray(peak(signal))
    assert np.all(found >= largest)
    assert np.all(found < 1.3 * largest)
    np.testing.assert_allclose(rms(signal), np.sqrt(np.mean(np.square(signal), axis=1)))


def test_a_signal_of_zeros_has_no_weight_and_no_nan():
    signals = made_up(3)._replace(error=jnp.zeros((5, 200)))
    weights = Objective(peak=1e6, load_error=1e-4).weights(signals)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(weights))
    assert not np.any(weights.error)


@pytest.fixture
def sum_of_squares():
    """A registered aggregation, gone again afterwards."""

    @tuning.register_aggregation("sum of squares")
    def sum_of_squares(costs):
        return jnp.sum(costs**2)

    yield sum_of_squares
    AGGREGATIONS.remove("sum of squares")


def test_an_aggregation_of_ones_own_weighs_the_squares_by_its_gradient(sum_of_squares):
    objective, signals = Objective(aggregation="sum of squares"), made_up(4)
    costs = np.sqrt(np.mean((1e6 * np.asarray(signals.error)) ** 2, axis=1))
    assert float(objective(signals)) == pytest.approx(np.sum(costs**2))
    test_the_weighed_squares_have_the_gradient_of_the_objective(objective)


def test_the_packages_aggregations_are_not_replaced():
    with pytest.raises(ParameterError, match="aggregation 'mean': there is one of this name"):
        tuning.register_aggregation("mean")(jnp.max)
    assert AGGREGATIONS["mean"] is mean


def test_scenarios_that_cannot_stand_side_by_side_are_refused():
    longer = triangular(speed=0.010, stroke=0.0009, rounding=0.02, duration=0.2, rate=10_000.0)
    with pytest.raises(MotionError, match=r"longer: 2001 samples .* make their motions equally long"):
        ensemble([*scenarios(), Scenario("longer", drive(), longer)], SAMPLING, settle=0.03)
    with pytest.raises(ParameterError, match="differ in kind"):
        ensemble([*scenarios(), Scenario("no delay", paper_drive(), MOTION)], SAMPLING, settle=0.03)
    with pytest.raises(MotionError, match=r"nothing is left of 0\.15 s of motion after 1 s"):
        ensemble(scenarios(), SAMPLING, settle=1.0)
    with pytest.raises(ParameterError, match="no scenario"):
        ensemble([], Sampling(), settle=0.1)


@pytest.mark.long
def test_a_lane_is_the_scenario_simulated_alone():

    given_controller = as_arrays(smooth(controller()))
    both = lanes().signals(given_controller)
    for k, one in enumerate(scenarios()):
        alone = ensemble([one], SAMPLING, settle=0.03).signals(given_controller)
        np.testing.assert_allclose(both.error[k], alone.error[0], rtol=1e-6, atol=1e-15)
        np.testing.assert_allclose(both.command_change[k], alone.command_change[0], rtol=1e-6, atol=1e-8)
