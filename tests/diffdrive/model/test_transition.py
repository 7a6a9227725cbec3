"""The closed-form matrix exponential against scipy's, and its derivative against the Frechet derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.linalg import expm, expm_frechet

from diffdrive.model.friction import LuGreCoefficients, lugre_coefficients
from diffdrive.model.parameters import Plant
from diffdrive.model.quantity import Directional
from diffdrive.model.transition import state_matrices

SPEEDS = np.concatenate([[0.0], *(sign * np.logspace(-12, 0, 61) for sign in (1, -1))])
ENTRIES = ([0, 0, 1, 1, 2, 2], [1, 2, 1, 2, 1, 2])
PLANT = Plant(mass=100.0, damping=Directional(380.0, 260.0))


def generator(bristle, mass, damping):
    """d/dt [x, v, z, u] of eq. (8), the constant force u as a fourth state."""
    drag = bristle.damping + bristle.viscous + damping
    spring = bristle.stiffness - bristle.damping * bristle.rate
    return np.array([[0, 1, 0, 0], [0, -drag / mass, -spring / mass, 1 / mass], [0, 1, -bristle.rate, 0], [0] * 4])


def closed_form(bristle, velocity, time):
    ad, bd = state_matrices(PLANT, bristle, velocity, time)
    return jnp.stack([jnp.stack([*map(jnp.asarray, row), b]) for row, b in zip(ad, bd, strict=True)])


evaluate = jax.jit(closed_form)


def damping_towards(velocity):
    return 380.0 if velocity >= 0 else 260.0


def assert_matches(bristle, velocity, time):
    tolerance = 1e-9
    ours = np.asarray(evaluate(bristle, velocity, time))
    exact = expm(generator(jax.tree.map(float, bristle), 100.0, damping_towards(velocity)) * time)[:3]
    assert (np.abs(ours[:, :3] - exact[:, :3]) / np.maximum(1.0, np.abs(exact[:, :3]) * 1e-3)).max() < tolerance
    # entries that have decayed below 1e-14 are rounding, ours and scipy's
    size = np.maximum(np.abs(exact[ENTRIES]), 1e-14)
    assert (np.abs(ours[ENTRIES] - exact[ENTRIES]) / size).max() < tolerance
    np.testing.assert_allclose(ours[:, 3], exact[:, 3], rtol=tolerance)


@pytest.mark.long
@pytest.mark.parametrize("time", [1e-4, 1e-3, 2e-3])
@pytest.mark.parametrize("load", [0.0, 10_000.0])
def test_ad_and_bd_are_the_matrix_exponential_from_stick_to_traverse(drive, time, load):
    for v in SPEEDS:
        assert_matches(lugre_coefficients(drive.friction, v, v, load), v, time)


def with_discriminant(share, rate=200.0):
    """A bristle whose eigenvalues lie sqrt(share) of their half-difference of rates apart; 0: a double one."""
    damping, viscous = 4540.0, 1826.5
    half = 0.5 * ((damping + viscous + 380.0) / 100.0 - rate)
    return LuGreCoefficients((1 - share) * half**2 * 100.0 + damping * rate, damping, viscous, 70.0, rate)


@pytest.mark.parametrize("share", [0.0, 1e-16, -1e-16, 1e-12, -1e-12, 1e-8, -1e-8, 1e-4, -1e-4, 1.0, -10.0])
@pytest.mark.parametrize("time", [1e-4, 2e-3, 5e-2])
def test_nearly_equal_eigenvalues(share, time):
    assert_matches(with_discriminant(share), 0.01, time)


def by_one(value, bristle, time, *, name):
    return closed_form(bristle._replace(**{name: value}), 0.01, time)


VALUE = jax.jit(by_one, static_argnames="name")
SLOPE = jax.jit(jax.jacfwd(by_one), static_argnames="name")


@pytest.mark.parametrize("share", [0.0, 1e-12, -1e-12, 1e-6, -1e-6, 1e-2])
@pytest.mark.parametrize("time", [1e-4, 2e-3])
@pytest.mark.parametrize("name", ["stiffness", "damping", "viscous", "rate"])
def test_derivative_at_nearly_equal_eigenvalues(share, time, name):
    bristle = with_discriminant(share)
    value = getattr(bristle, name)
    forward = np.asarray(SLOPE(value, bristle, time, name=name))
    step = 1e-3 * value
    direction = [generator(bristle._replace(**{name: value + s}), 100.0, 380.0) * time for s in (step, -step)]
    here = generator(bristle, 100.0, 380.0) * time
    exact = expm_frechet(here, (direction[0] - direction[1]) / (2 * step), compute_expm=False)[:3]
    scale = np.maximum(np.abs(exact), 1e-9 * np.abs(exact).max())
    assert (np.abs(forward - exact) / scale).max() < 1e-6
    ahead, behind = (np.asarray(VALUE(value + s, bristle, time, name=name)) for s in (step, -step))
    central = (ahead - behind) / (2 * step)
    assert np.abs(central - forward).max() < 1e-5 * np.abs(forward).max()


@pytest.mark.parametrize("rate_times_period", [1e1, 1e2, 1e3, 1e4])
@pytest.mark.parametrize("time", [1e-4, 2e-3])
def test_stiff_bristle(rate_times_period, time):
    stiffness = 3.35e7
    bristle = LuGreCoefficients(stiffness, 4540.0, 1826.5, 70.0, rate_times_period / time)
    assert_matches(bristle, 0.1, time)


@pytest.mark.parametrize("turns", [1.0, 21.0, 63.0, 200.0])
def test_oscillating_bristle(turns):
    """omega T up to 200: many turns of the bristle's resonance within one period."""
    assert_matches(LuGreCoefficients(100.0 * (turns / 2e-3) ** 2, 100.0, 50.0, 70.0, 3.0), 1e-4, 2e-3)


@pytest.mark.parametrize("stiffness", [1e4, 1e5, 1e6, 1e9])
@pytest.mark.parametrize("time", [1e-4, 1e-3])
def test_soft_and_hard_bristles(stiffness, time):
    for v in (0.0, 1e-3, -0.1):
        assert_matches(LuGreCoefficients(stiffness, 100.0, 50.0, 70.0, stiffness * abs(v) / 70.0), v, time)


def test_every_derivative_is_finite_from_stick_to_traverse(drive):
    def by_speed(v, time):
        return closed_form(lugre_coefficients(drive.friction, v, v, 0.0), v, time)

    slopes = jax.jit(jax.vmap(jax.jacfwd(by_speed), in_axes=(0, None)))(jnp.asarray(SPEEDS), 1e-4)
    assert np.all(np.isfinite(slopes))
    total = jax.jit(jax.vmap(jax.grad(lambda v: by_speed(v, 1e-4).sum())))(jnp.asarray(SPEEDS))
    np.testing.assert_allclose(total, np.asarray(slopes).sum((1, 2)), rtol=1e-9)
