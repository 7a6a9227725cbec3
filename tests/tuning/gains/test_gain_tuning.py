"""The auto-tuner on a small problem: its derivatives, its requirements, its starts, and that a kill costs nothing."""

import json

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.errors import CheckpointError
from diffdrive.loop.smooth import smooth
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.paper import scenario as paper
from tests.support.small_tuning import LIMITS, controller, drive, lanes, requirements, small_problem
from tuning.gains.checkpoint import CHECKPOINT
from tuning.gains.constrained import ConstrainedGains, evaluate, linearise_at, tuning_problem
from tuning.gains.objective import Objective
from tuning.gains.requirements import LoopLimits
from tuning.gains.sequential import (
    CUT_TOLERANCE,
    FEASIBILITY_TOLERANCE,
    SearchState,
    _rms_model,
    _solve_subproblem,
    search,
)
from tuning.gains.tune import SearchOptions, default_space, gain_names, gain_units, tune
from tuning.optimisation.space import search_space

CONTROLLERS = ["PD", "DOBVSC", "PD+FF+DOB", "PD+FC", "PD+FC+LE", "PD+FC+LS"]
# what the tests tune, asked once
TIGHT = LIMITS._replace(command_noise=8.0)


def tuned(limits=LIMITS, **settings):
    return tune(controller(), lanes(), requirements(limits), **settings)


@pytest.fixture(scope="module")
def usual():
    return tuned()


QUESTIONS = {
    "PD+FC": Objective(),
    "PD+FC+LS": Objective(),
    "PD+FC+LE": Objective(peak=2e5, load_error=1e-5, aggregation="worst"),
}


@pytest.mark.long
@pytest.mark.parametrize("name", ["PD", *(pytest.param(name, marks=pytest.mark.slow) for name in QUESTIONS)])
def test_every_derivative_that_the_search_uses_is_that_of_differences(name):
    gains, problem, space = small_problem(objective=QUESTIONS.get(name, Objective()), name=name)
    y = jnp.asarray(0.2 * np.random.default_rng(1).normal(size=len(space.free)))
    at, h = linearise_at(gains, y, problem), 1e-4
    for k in range(len(y)):
        ahead, behind = (evaluate(gains, y + sign * h * jnp.eye(len(y))[k], problem) for sign in (1.0, -1.0))
        slope = float(ahead.objective - behind.objective) / (2 * h)
        assert float(at.gradient[k]) == pytest.approx(slope, rel=1e-5, abs=1e-6 * float(jnp.max(jnp.abs(at.gradient))))
        for key, values in ahead.constraints.items():
            difference = (np.asarray(values) - np.asarray(behind.constraints[key])) / (2 * h)
            found = np.asarray(at.constraint_jacobians[key])[:, k]
            loose = 1e-3 if key == "stability" else 1e-5  # a growth rate is the logarithm of what rounds near one
            np.testing.assert_allclose(
                found, difference, rtol=loose, atol=loose * max(1e-2, np.max(np.abs(difference)))
            )


ON_THE_LOAD = LIMITS._replace(load_error=np.array([100.0, 100.0]))


@pytest.fixture(scope="module")
def friction_of_an_observer():
    """The friction that it believes, as gains, with the problem, and where it believes the true one."""
    every = default_space(controller(), friction=True)
    space = search_space(controller(), [one for one in every.free if "coulomb_screw" in one.path])
    problem = tuning_problem(as_arrays(smooth(controller())), space, lanes(), requirements(ON_THE_LOAD))
    gains = ConstrainedGains(space.free, Objective())
    return gains, problem, linearise_at(gains, jnp.zeros(2), problem)


@pytest.mark.slow
def test_a_limited_rms_is_predicted_as_the_curve_it_is(friction_of_an_observer):
    """An observer that believes the true friction errs little: a step in that friction bends the load error's RMS."""
    (gains, problem, at), d = friction_of_an_observer, np.array([0.3, -0.2])
    truth = np.asarray(evaluate(gains, jnp.asarray(d), problem).constraints["load error"])
    straight = np.asarray(at.point.constraints["load error"]) + np.asarray(at.constraint_jacobians["load error"]) @ d
    curve, slope = _rms_model(at, "load error", d)
    assert np.all(np.abs(curve - truth) < 0.3 * np.abs(straight - truth))
    ahead, behind = (_rms_model(at, "load error", d + sign * 1e-6 * np.eye(2)[0])[0] for sign in (1.0, -1.0))
    np.testing.assert_allclose(slope[:, 0], (ahead - behind) / 2e-6, rtol=1e-6)


@pytest.mark.slow
def test_a_step_keeps_a_limited_rms_that_its_line_would_break(friction_of_an_observer):
    """The program's step stays within the predicted curve, which is convex: every cut lies below it."""
    at = friction_of_an_observer[2]
    values = np.asarray(at.point.constraints["command noise"])
    one = np.zeros((len(values), 3, 3))
    one[:] = np.diag([(1.0 + values[0]) ** 2, 4.0, 4.0])  # flat here, and steep a step away
    one[:, 0, 0] = (1.0 + values) ** 2
    errors = np.asarray(at.point.constraints["load error"])
    level = jnp.asarray((1.0 + errors)[:, None, None] ** 2 * np.diag([1.0, 0.0, 0.0]))  # nothing changes it
    bowl = at._replace(
        slope=jnp.asarray([-10.0, 5.0]),
        curvature=jnp.eye(2),
        constraint_jacobians={
            **at.constraint_jacobians,
            "command noise": jnp.zeros((len(values), 2)),
            "load error": jnp.zeros((len(errors), 2)),
        },
        products={**at.products, "command noise": jnp.asarray(one), "load error": level},
    )
    d, prices = _solve_subproblem(bowl, 1.0)
    assert np.linalg.norm(d) > 0.05
    assert np.max(_rms_model(bowl, "command noise", d)[0]) <= 2 * CUT_TOLERANCE
    assert np.max(prices["command noise"]) > 0


@pytest.mark.parametrize("name", CONTROLLERS)
def test_every_controller_has_gains_to_tune(name):
    given = paper.controllers(drive())[name]
    space = default_space(given)
    assert {"kp", "kd"} <= set(space.names)
    values = np.asarray(space.values(np.zeros(len(space.free))))
    again = space.insert(as_arrays(given), np.zeros(len(values)))
    for ours, theirs in zip(jax.tree.leaves(again), jax.tree.leaves(as_arrays(given)), strict=True):
        assert float(ours) == pytest.approx(float(theirs), rel=1e-12)


def in_own_words(given, *, friction=False):
    """The names and units of what is tuned of a controller."""
    space = default_space(given, friction=friction)
    return list(gain_names(given, space).values()), gain_units(given, space)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_gains_are_called_as_the_controller_calls_them(name):
    given = paper.controllers(drive())[name]
    assert in_own_words(given)[0] == list(given.tunables)


def test_what_is_tuned_has_the_unit_of_its_declaration():
    names, units = in_own_words(controller(), friction=True)
    told = dict(zip(names, units, strict=True))
    assert (told["kp"], told["kd"], told["Q_load"], told["R"]) == ("N/m", "N*s/m", "N^2", "m^2")
    assert (told["viscous.positive"], told["load_coefficient.negative"]) == ("N*s/m", "1")


def test_friction_can_be_tuned_along_in_each_direction():
    space = default_space(controller(), friction=True)
    assert len(space.free) == 7 + 14
    assert any(one.path == "observer.friction.bristle_damping.negative" for one in space.free)


@pytest.mark.long
def test_tuning_gains_a_lot_and_keeps_what_is_required(usual):
    assert usual.status == "converged"
    assert usual.feasible
    assert not usual.violated
    assert float(usual.point.objective) < 0.5 * float(usual.initial_point.objective)
    for values in usual.point.constraints.values():
        assert float(jnp.max(values)) <= FEASIBILITY_TOLERANCE
    assert all(isinstance(leaf, float) for leaf in jax.tree.leaves(usual.controller))
    assert float(usual.controller.tracking.gains.kp) == pytest.approx(usual.after[usual.names.index("kp")])
    assert np.all(usual.tolerance >= 1.0)
    history = usual.best.state.history
    assert [entry[0] for entry in history] == sorted(entry[0] for entry in history)


@pytest.mark.long
def test_what_binds_is_named_and_is_worth_what_is_said(usual):
    """Relaxing the noise by 2 % lowers the objective by about twice what 1 % is said to be worth."""
    worths = {one.name: one.gain for one in usual.binding}
    assert "command noise" in worths
    relaxed = tuned(LIMITS._replace(command_noise=1.02 * LIMITS.command_noise))
    gained = 100.0 * (1.0 - float(relaxed.point.objective) / float(usual.point.objective))
    assert gained == pytest.approx(2.0 * worths["command noise"], rel=0.6, abs=0.3)


@pytest.mark.long
def test_what_cannot_be_kept_is_said_with_by_how_much():
    both = LoopLimits(phase=np.radians(80.0), gain_up=20.0, gain_down=20.0, command_noise=2.0)
    found = tuned(both, options=SearchOptions(starts=1, max_steps=8))
    assert not found.feasible
    assert found.violated
    assert all(share > FEASIBILITY_TOLERANCE for share in found.violated.values())
    assert "infeasible" in found.status or "stopped" in found.status


@pytest.mark.slow
@pytest.mark.parametrize("factor", [0.1, 0.3])
def test_an_unstable_start_is_led_to_stable_gains(factor, usual):
    gains = controller().tracking.gains
    far = eqx.tree_at(
        lambda c: (c.tracking.gains.kp, c.tracking.gains.kd), controller(), (20.0 * gains.kp, factor * gains.kd)
    )
    found = tune(far, lanes(), requirements(), search_space(far, default_space(controller()).free))
    assert float(jnp.max(found.initial_point.constraints["stability"])) > 0.0
    assert found.feasible
    assert float(found.point.objective) < 1.05 * float(usual.point.objective)


@pytest.mark.long
def test_a_killed_search_goes_on_to_the_same_end(tmp_path, usual):
    for steps in (1, 2, 5):

        def stop(count, most, cost, steps=steps):
            if count >= steps:
                raise KeyboardInterrupt

        tuned(resume=str(tmp_path), progress=stop)
    finished = tuned(resume=str(tmp_path))
    assert finished.best.state.steps == usual.best.state.steps
    np.testing.assert_allclose(finished.after, usual.after, rtol=1e-12)
    assert float(finished.point.objective) == pytest.approx(float(usual.point.objective), rel=1e-12)


@pytest.mark.long
def test_a_checkpoint_of_another_problem_or_damaged_is_refused(tmp_path):
    path = tmp_path / CHECKPOINT

    def stop(count, most, cost):
        raise KeyboardInterrupt

    tuned(resume=str(tmp_path), progress=stop)
    with pytest.raises(CheckpointError, match=r"checkpoint\.json: is the checkpoint of another tuning .* delete it"):
        tuned(TIGHT, resume=str(tmp_path))
    held = json.loads(path.read_text())
    for text in ("{", json.dumps({"problem": held["problem"]}), json.dumps(held | {"standings": {"0": {"y": 3}}})):
        path.write_text(text)
        with pytest.raises(CheckpointError, match="is no checkpoint of a tuning"):
            tuned(resume=str(tmp_path))


@pytest.mark.long
def test_an_interrupted_tuning_returns_the_best_so_far():
    def stop(count, most, cost):
        if count == 2:
            raise KeyboardInterrupt

    found = tuned(progress=stop)
    assert found.status == "interrupted after 2 steps"
    assert float(found.point.objective) <= float(found.initial_point.objective)


@pytest.mark.long
def test_a_search_that_runs_out_of_steps_says_so():
    assert tuned(options=SearchOptions(max_steps=2)).status == "stopped after 2 steps"


@pytest.mark.long
def test_a_start_that_diverges_is_reported_and_not_searched():
    gains, problem, space = small_problem()
    found = search(gains, problem, SearchState(tuple(30.0 for _ in space.free)))
    assert (
        found.state.steps == 0
        or found.linearised.point.violation <= FEASIBILITY_TOLERANCE
        or found.state.status != "running"
    )
