"""The force error of decimated inverse dynamics, and drives with effects registered on other logs."""

import dataclasses

import pytest

from diffdrive.effects.forces import Cogging, ConstantForce
from diffdrive.effects.friction import PreslidingHysteresis
from diffdrive.effects.scale import InterpolationError
from diffdrive.motion.builders import from_array
from experiments.studies.force_error import force_error
from experiments.studies.registration import registered
from tests.support.sound_log import DRIVE, simulate_log, two_sines

PUSHES = Cogging(0.0012, 5.0, 3.0)


def with_effects(*effects):
    return dataclasses.replace(DRIVE, drive=dataclasses.replace(DRIVE.drive, effects=effects))


@pytest.mark.long
def test_inverse_dynamics_know_the_effects_of_a_drive():
    log = simulate_log(with_effects(PUSHES), two_sines())
    right, wrong = (force_error(dataclasses.replace(DRIVE.drive, effects=one), log) for one in ((PUSHES,), ()))
    assert right < 0.5
    assert wrong > 4.0 * right
    assert force_error(DRIVE.drive, simulate_log(DRIVE, two_sines())) < 0.5


def test_inverse_dynamics_count_presliding_elements_once():
    """They replace the bristle's force, which the friction along the motion has: mostly a motion of presliding."""
    elements, reference = PreslidingHysteresis(1.0, 8e-6, 0.2), two_sines()
    small = from_array(reference.time, 0.01 * reference.position)
    log = simulate_log(with_effects(elements), small)
    known, missing = (force_error(with_effects(*one).drive, log) for one in ((elements,), ()))
    assert known < 0.1 * missing


@pytest.mark.long
def test_a_session_is_registered_anew():
    """Another start, so that the cogging has another phase, and another tilt; the period stays the machine's."""
    elsewhere = Cogging(0.0012, -4.0, 4.2)
    log = simulate_log(with_effects(elsewhere, ConstantForce(0.6)), two_sines())
    carried = dataclasses.replace(DRIVE.drive, effects=(PUSHES,))
    found = registered(carried, log, seconds=2.0)
    assert force_error(found, log) < 0.2 * force_error(carried, log)
    cogging, tilt = found.effects
    assert (float(cogging.cosine), float(cogging.sine)) == pytest.approx((-4.0, 4.2), abs=0.15)
    assert float(cogging.period) == pytest.approx(0.0012)
    assert float(tilt.force) == pytest.approx(0.6, abs=0.2)


@pytest.mark.long
def test_a_wave_far_larger_than_is_usual_is_registered_anew():
    """Its phase is of the session, however large the wave; only a time far away stays where it is."""
    elsewhere = InterpolationError(period=5e-4, cosine=0.0, sine=3e-6)
    log = simulate_log(with_effects(elsewhere), two_sines())
    carried = dataclasses.replace(DRIVE.drive, effects=(InterpolationError(period=5e-4, cosine=3e-6, sine=0.0),))
    (wave,) = (one for one in registered(carried, log, seconds=2.0).effects if one.name == "interpolation_error")
    assert (float(wave.cosine), float(wave.sine)) == pytest.approx((0.0, 3e-6), abs=2e-7)
