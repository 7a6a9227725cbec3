"""The search space, the least-squares search and the gain tuning built on them."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from diffdrive.controllers import PD
from diffdrive.controllers.base import Gains, Tracking, paper_tracking
from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.motion import triangular
from diffdrive.parameters import Actuator, Plant, Sampling, as_arrays
from diffdrive.presets import PAPER_KD, PAPER_KP, paper_drive
from experiments import paper
from tuning.gains import default_space, tune
from tuning.least_squares import levenberg_marquardt
from tuning.objective import Scales, ensemble
from tuning.space import Free, around, space_of

SAMPLING = Sampling(substeps=2)
MOTION = triangular(speed=0.010, stroke=0.002, rounding=0.05, duration=0.3, rate=10_000.0, first_reversal=0.15)


@given(st.lists(st.floats(-50, 50), min_size=3, max_size=3))
def test_no_point_of_a_space_leaves_its_bounds(y):
    plant = Plant(mass=100.0, damping=(380.0, 260.0), constant_force=2.0)
    bounds = (Free("mass", 50.0, 300.0), Free("constant_force", -5.0, 5.0), Free("damping.negative", 1.0, 1e3))
    space = space_of(plant, bounds)
    values = np.asarray(space.values(np.array(y)))
    for value, (_, low, high) in zip(values, bounds, strict=True):
        assert low * (1 - 1e-12) <= value <= high * (1 + 1e-12) or low <= value <= high


def test_the_origin_of_a_space_is_the_model_it_was_made_from():
    plant = Plant(mass=100.0, damping=(380.0, 260.0), constant_force=2.0)
    space = space_of(plant, [Free("mass", 50.0, 300.0), Free("constant_force", -5.0, 5.0)])
    again = space.insert(as_arrays(plant), np.zeros(2))
    np.testing.assert_allclose([again.mass, again.constant_force], [100.0, 2.0], rtol=1e-12)
    np.testing.assert_array_equal([again.damping.positive, again.damping.negative], [380.0, 260.0])


def test_a_parameter_per_direction_moves_in_both_or_in_one():
    plant = Plant(mass=100.0, damping=(300.0, 300.0))
    both = space_of(plant, [Free("damping", 1.0, 1e3)]).insert(as_arrays(plant), np.ones(1))
    one = space_of(plant, [Free("damping.negative", 1.0, 1e3)]).insert(as_arrays(plant), np.ones(1))
    assert both.damping.positive == both.damping.negative > 300.0
    assert one.damping.positive == 300.0 < one.damping.negative


def test_parameters_near_their_bounds_are_named():
    space = around(Gains(1e6, 1e3), {"kp": 2.0, "kd": 2.0})
    assert space.at_bound(np.array([0.0, 0.0])) == []
    assert space.at_bound(np.array([9.0, -9.0])) == ["kp", "kd"]


def test_directions_that_differ_are_not_moved_as_one():
    with pytest.raises(ParameterError, match=r"free 'damping\.positive' and 'damping\.negative'"):
        space_of(Plant(mass=100.0, damping=(380.0, 260.0)), [Free("damping", 1.0, 1e3)])


@pytest.mark.parametrize(
    ("bounds", "says"),
    [(Free("kq", 1.0, 2.0), "no parameter 'kq'.*known: .*kp"), (Free("kp", 1.0, 2.0), "not inside its bounds.*widen")],
)
def test_impossible_spaces_are_refused(bounds, says):
    with pytest.raises(ParameterError, match=says):
        space_of(Gains(1e6, 1e3), [bounds])


def test_a_parameter_that_is_zero_stays_zero():
    assert around(Gains(1e6, 0.0), {"kp": 2.0, "kd": 2.0}).names == ["kp"]


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
    np.testing.assert_allclose(found.y, [1.0, 1.0], atol=1e-6)
    assert found.status == "converged"
    assert [step for step, _ in seen] == list(range(1, found.steps + 1))
    assert np.all(np.diff([cost for _, cost in seen]) <= 0)


def test_a_search_that_runs_out_of_steps_says_so_and_returns_its_best():
    found = search_rosenbrock(
        max_steps=3,
    )
    assert found.status == "stopped after 3 steps, still falling"
    assert found.cost == min(found.history) <= found.cost_before


def test_an_interrupted_search_returns_the_best_it_has_seen():
    def progress(step, most, cost):
        if step == 3:
            raise KeyboardInterrupt

    found = search_rosenbrock(
        max_steps=100,
        progress=progress,
    )
    assert found.status == "interrupted after 2 steps"
    assert found.cost == min(found.history) < found.cost_before


def test_a_search_from_a_diverging_start_is_refused():
    with pytest.raises(DivergenceError, match="diverges where the search starts"):
        levenberg_marquardt(lambda y, _: jnp.log(y), np.array([-1.0]), None, max_steps=3, tolerance=1e-3)


def loads(*values):
    return np.outer(values, np.ones(len(MOTION.time)))


def test_the_cost_of_an_ensemble_is_the_root_mean_square_of_its_loads():
    drive = paper_drive(quantised=False)
    controller = as_arrays(PD(paper_tracking(drive, PAPER_KP, PAPER_KD)))
    scales = Scales(error=1e-6, command_noise=1e9, load_error=1e9)

    def cost(*values):
        scenarios = ensemble(drive, MOTION, loads(*values), SAMPLING, settle=0.05, scales=scales)
        return float(jnp.linalg.norm(scenarios.residuals(controller)))

    separate = [cost(0.0), cost(12_600.0)]
    assert cost(0.0, 12_600.0) == pytest.approx(np.sqrt(np.mean(np.square(separate))), rel=1e-9)
    assert separate[0] == pytest.approx(10.5, rel=0.2)  # um: friction over Kp


def test_the_quantiser_becomes_the_noise_of_the_same_variance():
    scenarios = ensemble(paper_drive(), MOTION, loads(0.0), SAMPLING, settle=0.05)
    assert scenarios.drive.sensor.resolution is None
    assert float(scenarios.drive.sensor.noise) == pytest.approx(1e-7 / np.sqrt(12))


def test_tuning_finds_the_feedforward_that_cancels_inertia_and_damping():
    """Only the feed-forward is free and the friction is nearly nothing: the optimum is the plant's own mass."""
    drive = paper_drive(quantised=False)
    drive = eqx.tree_at(lambda d: d.plant.mass, drive, 80.0)
    controller = PD(Tracking(Gains(PAPER_KP, PAPER_KD), paper_tracking(drive, 1.0, 1.0).feedforward))
    controller = eqx.tree_at(lambda c: c.tracking.feedforward.mass, controller, 130.0)
    fast = triangular(speed=0.05, stroke=0.01, rounding=0.05, duration=0.4, rate=10_000.0, first_reversal=0.2)
    frictionless = eqx.tree_at(lambda d: d.friction, drive, jax.tree.map(lambda leaf: 1e-6 * leaf, drive.friction))
    frictionless = eqx.tree_at(
        lambda d: (d.friction.stribeck_velocity, d.friction.initial_load),
        frictionless,
        (drive.friction.stribeck_velocity, 0.0),
    )
    scenarios = ensemble(
        frictionless, fast, np.zeros((1, len(fast.time))), SAMPLING, settle=0.01,
        scales=Scales(error=1e-8, command_noise=1e9),
    )  # fmt: skip
    tuned = tune(controller, scenarios, around(controller, {"tracking.feedforward.mass": 3.0}), tolerance=1e-8)
    assert tuned.after[0] == pytest.approx(80.0, rel=1e-2)
    assert tuned.search.cost < 0.1 * tuned.search.cost_before


def test_tuning_the_papers_controller_lowers_its_cost_and_keeps_to_its_bounds():
    drive = eqx.tree_at(lambda d: d.actuator, paper_drive(), Actuator(delay_samples=1))
    controller = paper.controllers(drive)["PD+FC+LE"]
    scenarios = ensemble(drive, MOTION, loads(0.0, 8_000.0), SAMPLING, settle=0.1)
    tuned = tune(controller, scenarios, max_steps=6)
    assert tuned.names == ["kp", "kd", "position", "velocity", "bristle", "measurement", "gain"]
    assert tuned.search.cost < 0.95 * tuned.search.cost_before
    low, high = np.array([[free.low, free.high] for free in default_space(controller).free]).T
    assert np.all((tuned.after >= low) & (tuned.after <= high))
    assert float(tuned.controller.tracking.gains.kp) == pytest.approx(tuned.after[0])
    assert all(isinstance(leaf, float) for leaf in jax.tree.leaves(tuned.controller))


@pytest.mark.parametrize("name", ["PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE", "PD+FC+LS"])
def test_every_controller_has_gains_to_tune(name):
    controller = paper.controllers(paper_drive())[name]
    space = default_space(controller)
    assert {"kp", "kd"} <= set(space.names)
    values = np.asarray(space.values(np.zeros(len(space.free))))
    again = space.insert(as_arrays(controller), np.zeros(len(values)))
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(as_arrays(controller)), strict=True):
        assert float(ours) == pytest.approx(float(theirs), rel=1e-12)
