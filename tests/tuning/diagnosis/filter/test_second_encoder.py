"""A second encoder: what a hypothesis foresees of motor against table, and what that says for it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive.effects.scale import LeadError
from diffdrive.effects.transmission import Compliance
from diffdrive.model.friction import coulomb
from diffdrive.numerics.arrays import as_arrays
from tests.support.sound_log import DRIVE, RATE, simulate_log, two_sines
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.filter.ekf import ProcessNoise, run_filter
from tuning.diagnosis.filter.second_encoder import Twist, predicted_twist, twist_deviance, twist_of
from tuning.identification.prediction import Lanes

PERIOD = 1.0 / RATE


def sliding(speed=0.02, seconds=1.0, beside=0.0):
    """A table that slides steadily, pushed by just its friction: the drive, what acts and was logged.

    A force `beside` (N) the motor's takes part in that.
    """
    drive, n = as_arrays(DRIVE.drive), round(seconds * RATE)
    position = jnp.asarray(speed * PERIOD * np.arange(n))[None]
    at = logged_of(DRIVE.drive, [simulate_log(DRIVE, two_sines())])
    one = jnp.ones((1, n))
    level = float(coulomb(drive.friction, 1.0, 0.0))
    friction = level + speed * float(drive.friction.viscous.positive + drive.plant.damping.positive)
    lanes = Lanes(position, friction * one, 0 * one, 0 * one, one, speed * jnp.ones(1))
    acts = EffectSignals(friction * one, *(0 * one for _ in range(5)), beside * one)
    return drive, acts, lanes, at.sampling, friction


def track_with(screw, drive, acts, lanes, sampling):
    """Where a filter that trusts the model takes the motor to be."""
    coupled = () if screw is None else (in_lane(screw),)
    return run_filter(drive, acts, coupled, ProcessNoise(1e-3, 1e-3), jnp.asarray(1e-8), lanes, sampling)


def in_lane(effect):
    return type(effect)(**{f.name: jnp.asarray([getattr(effect, f.name)]) for f in dataclasses.fields(effect)})


@pytest.mark.long
def test_a_screw_winds_up_by_what_it_carries_over_its_stiffness():
    """In steady sliding it carries the table's share of the friction."""
    *given, friction = sliding()
    screw = Compliance(frequency=200.0, damping=0.3, motor_share=0.4, table_friction=0.6)
    found = predicted_twist([in_lane(screw)], track_with(screw, *given))[0, -1]
    stiffness = 0.4 * 0.6 * float(given[0].plant.mass) * (2.0 * np.pi * 200.0) ** 2
    assert found == pytest.approx(0.6 * friction / stiffness, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize("beside", [-40.0, 40.0, 120.0])
def test_a_screw_does_not_carry_what_something_else_pushes(beside):
    """On an inclined axis: beyond the table's share of the friction, the screw holds it back."""
    *given, friction = sliding(beside=beside)
    screw = Compliance(frequency=200.0, damping=0.3, motor_share=0.4, table_friction=0.6)
    found = predicted_twist([in_lane(screw)], track_with(screw, *given))[0, -1]
    stiffness = 0.4 * 0.6 * float(given[0].plant.mass) * (2.0 * np.pi * 200.0) ** 2
    assert found == pytest.approx((0.6 * friction - beside) / stiffness, rel=0.03)


@pytest.mark.long
def test_an_error_of_the_scale_is_seen_the_other_way_round():
    *given, _ = sliding()
    effect = LeadError(lead=5e-3, cosine=2e-6)
    filtered = track_with(None, *given)
    found = predicted_twist([in_lane(effect)], filtered)
    np.testing.assert_allclose(
        found, -2e-6 * np.cos(2.0 * np.pi * np.asarray(filtered.trajectory.position) / 5e-3), atol=1e-12
    )


def test_a_twist_speaks_for_what_foresees_it_and_against_what_does_not():
    noise, rng = 1e-8, np.random.default_rng(3)
    shape = 1e-6 * np.sin(np.arange(2000) / 40.0)[None]
    flat = np.zeros((1, 2000))
    there = Twist(3e-3 + shape + noise * rng.standard_normal(shape.shape), np.ones_like(shape), noise)
    none = there._replace(value=there.value - shape)
    assert twist_deviance(there, flat, PERIOD) == 0.0
    assert twist_deviance(there, shape, PERIOD) < -100.0
    assert twist_deviance(none, shape, PERIOD) > 100.0
    assert twist_deviance(there, 0.5 * shape, PERIOD) < 0.0


def test_a_twist_that_was_not_measured_says_nothing():
    """Where the logs that are judged have no second encoder, though others have."""
    nothing = Twist(np.zeros((1, 50)), np.zeros((1, 50)), 1e-8)
    assert twist_deviance(nothing, np.ones((1, 50)), PERIOD) == 0.0


def test_a_log_has_a_twist_where_it_has_a_second_encoder():
    log = simulate_log(DRIVE, two_sines())
    lanes = logged_of(DRIVE.drive, [log]).lanes
    assert twist_of([log], lanes, 1e-8) is None
    both = dataclasses.replace(log, motor_position=log.position + 2e-6)
    found = twist_of([both], lanes, 1e-8)
    assert found.counts.sum() == np.asarray(lanes.counts).sum()
    np.testing.assert_allclose(found.value[found.counts > 0], 2e-6, rtol=1e-6)
