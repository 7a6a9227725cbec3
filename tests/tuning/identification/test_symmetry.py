"""What is believed of the two directions, and what speaks against an answer."""

import dataclasses
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from diffdrive import motion
from diffdrive.controllers import PDGains
from diffdrive.logs import Log
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.model.quantity import Directional
from experiments.studies.recovery.truth import truth_log
from tuning.identification.doubts import FACTOR, determined_sums, doubts
from tuning.identification.estimates import EstimateStatus, ParameterEstimate
from tuning.identification.identify import identify
from tuning.identification.row_force import BetweenRows
from tuning.identification.symmetry import DIRECTIONS_STD, departure_from_symmetry
from tuning.identification.unknowns import unknowns_of

RATE = 1_000.0
DRIVE = paper_drive()
BELIEVED = unknowns_of(DRIVE, 0.0)


def with_sides(unknowns, name, positive, negative):
    pair = getattr(unknowns, name)
    return dataclasses.replace(unknowns, **{name: Directional(positive * pair.positive, negative * pair.negative)})


def test_what_was_believed_departs_by_nothing_and_so_does_friction_that_grows_in_both_directions():
    for unknowns in (BELIEVED, with_sides(BELIEVED, "coulomb", 3.0, 3.0), with_sides(BELIEVED, "viscous", 0.1, 0.1)):
        np.testing.assert_allclose(departure_from_symmetry(unknowns, BELIEVED), 0.0, atol=1e-12)


@pytest.mark.parametrize("name", ["coulomb", "load_coefficient", "breakaway", "stribeck_velocity", "viscous"])
def test_a_direction_that_changes_alone_departs_by_its_logarithm_whichever_it_is(name):
    forwards = departure_from_symmetry(with_sides(BELIEVED, name, 1.3, 1.0), BELIEVED)
    backwards = departure_from_symmetry(with_sides(BELIEVED, name, 1.0, 1.3), BELIEVED)
    np.testing.assert_allclose(forwards, -backwards, atol=1e-12)
    assert float(jnp.sum(forwards**2)) == pytest.approx((np.log(1.3) / DIRECTIONS_STD) ** 2)


def test_a_constant_force_counts_against_friction_and_beyond_the_one_stated():
    stated = dataclasses.replace(BELIEVED, constant_force=500.0)
    moved = dataclasses.replace(BELIEVED, constant_force=500.0 + 7.0)
    level = 0.5 * (BELIEVED.coulomb.positive + BELIEVED.coulomb.negative)
    assert float(departure_from_symmetry(stated, stated)[-1]) == 0.0
    assert float(departure_from_symmetry(moved, stated)[-1]) == pytest.approx(7.0 / (DIRECTIONS_STD * level))


@pytest.mark.slow
def test_strokes_at_one_speed_leave_a_flat_axis_flat():
    """Away from reversals such a log shows one force for each direction, and nothing of what they are made of."""
    friction = dataclasses.replace(DRIVE.friction, coulomb_screw=Directional(120.0, 120.0))
    machine = dataclasses.replace(DRIVE, friction=friction)
    lap = motion.triangular(speed=0.05, stroke=0.05, rounding=0.05, duration=3.0, rate=RATE)
    log = truth_log(machine, PDGains(PAPER_KP / 10, PAPER_KD / 10), lap, 0.0, seed=3)
    found = identify([log], DRIVE, starts=2)
    level, true_level = found.drive.friction.coulomb_at(0.0), friction.coulomb_at(0.0)
    assert abs(float(found.drive.plant.constant_force)) < 0.1 * true_level.positive
    for side in ("positive", "negative"):
        assert float(getattr(level, side)) == pytest.approx(getattr(true_level, side), rel=0.2)


# --- what speaks against an answer


def estimate(name, value, unit="N", status=EstimateStatus.FITTED):
    return ParameterEstimate(f"friction.{name}", unit, value, value, value, value, value, value, status)


def test_of_two_that_are_hardly_told_apart_the_sum_or_the_difference_is_said_with_its_own_interval():
    rows = [estimate("one", 100.0), estimate("other", 20.0), estimate("speed", 3.0, "m/s")]
    covariance = np.array([[100.0, -99.0, 0.0], [-99.0, 100.0, 0.0], [0.0, 0.0, 1.0]])
    found = SimpleNamespace(
        estimates=rows,
        estimate_covariance=covariance,
        correlated=[("friction.one", "friction.other", -0.99), ("friction.one", "friction.speed", 0.97)],
    )
    (known,) = determined_sums(found)  # newtons and metres per second have no sum
    assert (known.first, known.second, known.sign, known.value) == ("one", "other", 1, 120.0)
    assert known.half_width == pytest.approx(1.96 * np.sqrt(2.0), rel=1e-3)
    covariance[0, 1] = covariance[1, 0] = 99.0
    found.correlated = [("friction.one", "friction.other", 0.99)]
    (known,) = determined_sums(found)
    assert (known.sign, known.value) == (-1, 80.0)
    assert known.half_width == pytest.approx(1.96 * np.sqrt(2.0), rel=1e-3)


def test_parts_that_are_known_well_enough_need_no_sum():
    """Such as a constant force of nothing, give or take a newton, beside a hundred of friction."""
    rows = [estimate("coulomb", 100.0), estimate("constant_force", 0.0)]
    covariance = np.array([[0.25, -0.249], [-0.249, 0.25]])
    pairs = [("friction.coulomb", "friction.constant_force", -0.996)]
    found = SimpleNamespace(estimates=rows, estimate_covariance=covariance, correlated=pairs)
    assert determined_sums(found) == []
    found.estimate_covariance = 400.0 * covariance  # 100 ± 20 N
    (known,) = determined_sums(found)
    assert known.value == 100.0


def flat_log(coulomb=100.0, mass=100.0, viscous=500.0, constant=0.0):
    """A sine whose command is that of inverse dynamics."""
    time = np.arange(6_000) / RATE
    angular, amplitude = 2 * np.pi * 0.7, 0.02
    position = amplitude * (1 - np.cos(angular * time))
    velocity, acceleration = (
        amplitude * angular * np.sin(angular * time),
        amplitude * angular**2 * np.cos(angular * time),
    )
    command = mass * acceleration + viscous * velocity + coulomb * np.sign(velocity) - constant
    return Log("flat", time=time, position=position, command=command)


def answer(positive, negative, constant=0.0, delay=0.0):
    friction = dataclasses.replace(
        DRIVE.friction, coulomb_screw=Directional(positive, negative), load_coefficient=Directional(0.0, 0.0)
    )
    plant = dataclasses.replace(DRIVE.plant, constant_force=constant)
    drive = dataclasses.replace(DRIVE, plant=plant, friction=friction)
    return SimpleNamespace(drive=drive, estimates=[SimpleNamespace(name="delay", value=delay)], rival=())


def test_friction_that_leaves_inverse_dynamics_by_a_factor_is_doubted_in_that_direction():
    log = flat_log()
    assert doubts(answer(100.0, 100.0), DRIVE, [log], []) == []
    assert doubts(answer(0.9 * FACTOR * 100.0, 100.0), DRIVE, [log], []) == []
    (against,) = doubts(answer(10.0, 190.0, constant=-90.0), DRIVE, [log], [])
    assert "forwards is 10 N" in against
    assert "shows 99.99 N" in against
    assert "-90 N" in against


def test_a_hanging_axis_whose_file_states_its_constant_force_is_not_doubted():
    hanging = answer(100.0, 100.0, constant=-600.0).drive
    log = flat_log(constant=-600.0)
    assert doubts(answer(100.0, 100.0, constant=-600.0), hanging, [log], []) == []
    assert doubts(answer(100.0, 100.0, constant=-600.0), DRIVE, [log], []) != []  # a file that says nothing of it


@pytest.mark.long
def test_an_answer_that_is_worse_on_held_out_logs_than_what_was_believed_is_doubted():
    lap = motion.sine(amplitude=5e-3, frequency=1.0, duration=2.0, rate=RATE)
    log = truth_log(DRIVE, PDGains(PAPER_KP / 10, PAPER_KD / 10), lap, 0.0, seed=4)
    true = SimpleNamespace(
        drive=DRIVE, estimates=[SimpleNamespace(name="delay", value=0.0)], rival=(), between=BetweenRows.HELD
    )
    heavy = dataclasses.replace(DRIVE, plant=dataclasses.replace(DRIVE.plant, mass=2.0 * DRIVE.plant.mass))
    wrong = SimpleNamespace(drive=heavy, estimates=true.estimates, rival=(), between=BetweenRows.HELD)
    used = [flat_log(coulomb=float(DRIVE.friction.coulomb_at(0.0).positive))]
    assert doubts(true, heavy, used, [log]) == []
    assert doubts(true, DRIVE, used, [log]) == []  # no change is no rise
    (against,) = doubts(wrong, DRIVE, used, [log])
    assert "held-out logs the disturbance force rose" in against


@pytest.mark.parametrize("believed", [0.0, 1e-3])
@pytest.mark.parametrize("found", [0.0, 2e-3])
def test_of_what_a_drive_has_nothing_it_is_alike(believed, found):
    """A load coefficient of zero has no ratio of its directions: log(0 / 0) made the search diverge at its start."""
    departed = departure_from_symmetry(
        with_sides(BELIEVED, "load_coefficient", found, found),
        with_sides(BELIEVED, "load_coefficient", believed, believed),
    )
    np.testing.assert_allclose(departed, 0.0, atol=1e-12)
