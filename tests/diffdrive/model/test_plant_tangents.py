"""Derivatives of the table over one period, side by side, and under a force that ripples within it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.model.friction import friction_under_load, midpoint_friction, midpoint_friction_with_slopes
from diffdrive.model.plant import PlantState, advance, advance_with_tangents
from diffdrive.numerics.arrays import as_arrays
from tests.support.sound_log import DRIVE


@jax.jit
def one_period(state, force):
    return advance(as_arrays(DRIVE.drive), state, force, 0.0, 5e-4, 10)


@jax.jit
def derivative(state, force, direction):
    return jax.jvp(one_period, (state, force), direction)[1]


@jax.jit
def side_by_side(state, force, directions):
    return advance_with_tangents(as_arrays(DRIVE.drive), state, force, jnp.asarray(0.0), 5e-4, 10, directions)


@pytest.mark.parametrize("velocity", [0.0, 1e-6, 0.02, -0.02])
@pytest.mark.parametrize("force", [0.0, 60.0, -200.0])
def test_tangents_side_by_side_are_the_derivatives(velocity, force):
    """At rest, in presliding, at breakaway, sliding, and through a reversal."""
    state = PlantState(*(jnp.asarray(one) for one in (0.01, velocity, 1e-7 * np.sign(velocity))))
    directions = [
        (PlantState(*jnp.asarray(row[:3])), jnp.asarray(row[3]))
        for row in np.random.default_rng(1).standard_normal((3, 4)) * np.array([1e-6, 1e-3, 1e-7, 1.0])
    ]
    ahead, tangents = side_by_side(state, jnp.asarray(force), directions)
    np.testing.assert_allclose(np.array(ahead), np.array(one_period(state, jnp.asarray(force))), rtol=1e-14)
    for direction, tangent in zip(directions, tangents, strict=True):
        expected = derivative(state, jnp.asarray(force), direction)
        np.testing.assert_allclose(np.array(tangent), np.array(expected), rtol=1e-10, atol=1e-18)


def rippled(velocity, seed=0):
    """A state, a force, how it ripples in each of five control periods, and what follows under each in turn."""
    drive = as_arrays(DRIVE.drive)
    state = PlantState(*(jnp.asarray(one) for one in (0.01, velocity, 1e-7 * np.sign(velocity))))
    ripple = 15.0 * np.random.default_rng(seed).standard_normal(5)
    ripple = jnp.asarray(ripple - ripple.mean())
    exact = state
    for more in ripple:
        exact = advance(drive, exact, 20.0 + more, 0.0, 1e-4, 400)
    return drive, state, ripple, np.array(exact)


@pytest.mark.long
@pytest.mark.parametrize("velocity", [0.0, 1e-5, -1e-3, 0.02])
def test_a_force_that_ripples_is_one_force_after_the_other(velocity):
    """Of second order in the substep, at rest, in presliding and in sliding; the mean force alone is far from it."""
    drive, state, ripple, exact = rippled(velocity)

    def off(substeps):
        found = advance(drive, state, 20.0, 0.0, 5e-4, substeps, jnp.repeat(ripple, substeps // 5))
        return np.abs(np.array(found) - exact)

    level = np.abs(np.array(advance(drive, state, 20.0, 0.0, 5e-4, 160)) - exact)
    assert off(10)[1] < 0.15 * level[1]
    assert np.all(off(160)[:2] < 1e-3 * level[:2])
    assert np.all(off(80) < 0.3 * off(40) + 1e-17)


@pytest.mark.parametrize("velocity", [0.0, 0.02])
def test_tangents_under_a_ripple_are_the_derivatives(velocity):
    drive, state, ripple, _ = rippled(velocity)
    ripple = jnp.repeat(ripple, 2)
    way = (PlantState(*jnp.asarray([1e-6, 1e-3, 1e-7])), jnp.asarray(1.0))

    def one_period(state, force):
        return advance(drive, state, force, 0.0, 5e-4, 10, ripple)

    ahead, (tangent,) = advance_with_tangents(
        drive, state, jnp.asarray(20.0), jnp.asarray(0.0), 5e-4, 10, [way], ripple
    )
    value, expected = jax.jvp(one_period, (state, jnp.asarray(20.0)), way)
    np.testing.assert_allclose(np.array(ahead), np.array(value), rtol=1e-14)
    np.testing.assert_allclose(np.array(tangent), np.array(expected), rtol=1e-10, atol=1e-18)


@pytest.mark.parametrize("velocity", [1e-7, -2e-5, 0.003, -0.2])
@pytest.mark.parametrize("bristle", [3e-8, -4e-6])
def test_slopes_of_friction_in_a_step_are_its_derivatives(velocity, bristle):
    """In presliding, about breakaway, sliding, and turned back against a deflected bristle."""
    drive = as_arrays(DRIVE.drive)
    friction, damping = friction_under_load(drive.friction, jnp.asarray(300.0)), drive.plant.damping

    def after(velocity, bristle):
        return jnp.stack(midpoint_friction(friction, damping, velocity, bristle, 5e-5))

    here = jnp.asarray(velocity), jnp.asarray(bristle)
    value, slopes = midpoint_friction_with_slopes(friction, damping, *here, 5e-5)
    by_velocity, by_bristle = jax.jacfwd(after, argnums=(0, 1))(*here)
    np.testing.assert_array_equal(jnp.stack(value), after(*here))
    np.testing.assert_allclose([slopes.force_by_velocity, slopes.bristle_by_velocity], by_velocity, rtol=1e-12)
    np.testing.assert_allclose([slopes.force_by_bristle, slopes.bristle_by_bristle], by_bristle, rtol=1e-12)
