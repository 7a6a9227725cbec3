"""A drive without Coulomb friction: the limit of LuGre friction as its level goes to zero, values and derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import diffdrive as dd
from diffdrive.errors import ParameterError
from diffdrive.loop.costs import running_costs
from diffdrive.loop.rollout import loop_inputs
from diffdrive.model import plant
from diffdrive.model.friction import LEAST_LEVEL_SINGLE, friction_force, lugre_coefficients, resolvable
from diffdrive.model.parameters import Sampling, check_drive, require_coulomb_friction
from diffdrive.model.presets import paper_drive
from diffdrive.numerics.arrays import as_arrays, in_precision_of

RATE = 1e4
MOTION = dd.motion.sine(amplitude=1e-3, frequency=5.0, duration=0.25, rate=RATE)
NONE = {"friction.coulomb_screw": 0.0, "friction.load_coefficient": 0.0, "friction.breakaway_gap": 0.0}


def without(controller="cascade", **more) -> dd.Axis:
    return dd.paper_axis(controller=controller, quantised=False).replace(NONE | more)


def test_all_that_is_left_is_viscous():
    run = dd.simulate(without(), MOTION)
    assert run.status.ok
    viscous = np.where(run.velocity >= 0.0, 1826.5, 1673.5) * run.velocity
    np.testing.assert_allclose(run.friction, viscous, rtol=0.0, atol=1e-11)


def test_the_motion_under_a_constant_force_is_the_exact_one():
    """M dv/dt = F - B v from rest: v = F / B (1 - exp(-B t / M)); the integrator is of second order."""
    drive = resolvable(without(**{"friction.viscous": 1800.0, "plant.damping": 0.0}).drive)
    state = plant.at_rest(jnp.zeros(()))
    period, force, rate = 1e-3, 50.0, 1800.0 / 100.0
    for _ in range(20):
        state = plant.advance(drive, state, force, 0.0, period, 50)
    decay = np.exp(-rate * 20 * period)
    assert float(state.velocity) == pytest.approx(force / 1800.0 * (1.0 - decay), rel=1e-8)
    travel = force / 1800.0 * (20 * period - (1.0 - decay) / rate)
    assert float(state.position) == pytest.approx(travel, rel=1e-7)
    assert abs(float(state.bristle)) < 1e-15


def test_a_tiny_friction_comes_near_in_proportion():
    zero = dd.simulate(without(), MOTION).table_position
    gaps = [
        np.max(np.abs(dd.simulate(without(**{"friction.coulomb_screw": level}), MOTION).table_position - zero))
        for level in (1e-2, 1e-4)
    ]
    assert 0.0 < gaps[1] < 2e-2 * gaps[0] < 2e-10


@pytest.mark.parametrize("controller", ["pd", "pd+fc", "pd+fc+ls", "pd+ff+dob", "dobvsc"])
def test_every_controller_runs_with_it_as_its_model(controller):
    run = dd.simulate(without(controller), MOTION)
    assert run.status.ok
    assert run.peak_error(0.05) < 1e-5


def squared_error(values: dict) -> jax.Array:
    run = dd.rollout(without().smooth().replace(values), MOTION)
    return 1e12 * jnp.mean((run.table_position - MOTION.position) ** 2)


@pytest.mark.parametrize(("path", "step"), [("friction.coulomb_screw", 1e-4), ("friction.viscous", 1.0)])
def test_derivatives_are_those_of_differences(path, step):
    """That by the Coulomb friction is one-sided, and without the bristle's damping: s1 / s0 of 0.1 ms, at reversals."""
    begin = 0.0 if path == "friction.coulomb_screw" else 1800.0
    slope = float(jax.grad(lambda value: squared_error({path: value}))(begin))
    at = [float(squared_error({path: begin + k * step})) for k in range(3)]
    assert slope == pytest.approx((-1.5 * at[0] + 2.0 * at[1] - 0.5 * at[2]) / step, rel=1e-2 if begin == 0.0 else 1e-4)


@pytest.mark.parametrize("kind", [jnp.float32, jnp.float64])
def test_values_and_derivatives_are_numbers_in_both_precisions(kind):
    axis = without()
    inputs = in_precision_of(kind(0.0), loop_inputs(MOTION, np.zeros(len(MOTION.time))))
    parts = in_precision_of(kind(0.0), as_arrays((axis.drive, axis.controller)))

    def rms(parts):
        counts = jnp.ones(len(MOTION.time), kind)
        return running_costs(*parts, inputs, counts, Sampling(RATE, 5)).rms

    value, slopes = jax.value_and_grad(rms)(parts)
    assert np.isfinite(float(value))
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in jax.tree.leaves(slopes))
    assert float(value) == pytest.approx(
        float(running_costs(axis.drive, axis.controller, loop_inputs(MOTION, np.zeros(len(MOTION.time))),
              jnp.ones(len(MOTION.time)), Sampling(RATE, 5)).rms), rel=1e-2
    )  # fmt: skip


def test_other_friction_stays_as_it_is_to_the_last_bit():
    drive = paper_drive()
    assert jax.tree.leaves(resolvable(drive)) == jax.tree.leaves(drive)
    single = in_precision_of(jnp.float32(0.0), as_arrays(drive))
    assert jax.tree.leaves(resolvable(single)) == jax.tree.leaves(single)
    small = eqx_level(drive, 2.0 * LEAST_LEVEL_SINGLE)
    assert float(resolvable(small).friction.coulomb_screw.positive) == 2.0 * LEAST_LEVEL_SINGLE


def eqx_level(drive, level):
    friction = dataclasses.replace(drive.friction, coulomb_screw=level, load_coefficient=0.0, breakaway_gap=0.0)
    return dataclasses.replace(drive, friction=friction)


@pytest.mark.parametrize("velocity", [0.0, 1e-9, -1e-3, 0.5])
def test_the_coefficients_are_numbers_at_rest_and_at_speed(velocity):
    friction = resolvable(without().drive).friction
    bristle = lugre_coefficients(friction, jnp.asarray(velocity), jnp.zeros(()), 0.0)
    drag = 1826.5 if velocity >= 0.0 else 1673.5
    assert float(friction_force(bristle, velocity, jnp.zeros(()))) == pytest.approx(drag * velocity, abs=1e-12)


def test_friction_that_no_machine_has_is_still_refused():
    check_drive(without().drive)
    check_drive(without(**{"friction.breakaway_gap": 5.0}).drive)
    for gap in (-1.0, -30.0):
        with pytest.raises(ParameterError, match="breakaway friction in the positive direction is -"):
            check_drive(without(**{"friction.breakaway_gap": gap}).drive)
    with pytest.raises(ParameterError, match="breakaway friction in the negative direction is 0 N: it must be above 0"):
        check_drive(without(**{"friction.coulomb_screw": (0.0, 5.0), "friction.breakaway_gap": (0.0, -5.0)}).drive)


def test_what_looks_for_friction_says_that_it_needs_some():
    with pytest.raises(ParameterError, match=r"friction\.coulomb_screw: identification looks for friction about"):
        require_coulomb_friction(without().drive, "identification")
    require_coulomb_friction(paper_drive(), "identification")
