"""What logs can determine, judged from motions and commands that are written down, without a simulation."""

import dataclasses

import numpy as np
import pytest

from diffdrive.logs import Log
from diffdrive.model.presets import paper_drive
from tuning.identification.excitation import SECOND_SPEED, shortcomings, shown_motion

RATE = 1_000.0
DRIVE = paper_drive()
TIME = np.arange(6_000) / RATE
MASS, VISCOUS, COULOMB = 100.0, 2_000.0, 100.0


def log_of(velocity, mass=MASS, noise=0.0):
    """A log of that velocity (m/s) whose command is that of inverse dynamics, with noise (N) of friction."""
    position = np.cumsum(velocity) / RATE
    command = mass * np.gradient(velocity, 1.0 / RATE) + VISCOUS * velocity + COULOMB * np.sign(velocity)
    scatter = noise * np.random.default_rng(0).standard_normal(len(velocity))
    return Log("lap", time=TIME, position=position, command=command + scatter)


def strokes(*speeds, period=1.0):
    """Half a period to and fro at each of the speeds in turn, with ramps of 20 ms."""
    count = int(TIME[-1] / period) + 1
    towards = np.sign(np.sin(2 * np.pi * TIME / period) + 1e-12)
    speed = np.array(speeds)[(TIME / period).astype(int) % len(speeds)]
    assert count >= len(speeds)
    return np.convolve(towards * speed, np.ones(20) / 20, mode="same")


def whats(*logs, drive=DRIVE, fixed=()):
    return [one.what for one in shortcomings(logs, drive, fixed)]


def test_strokes_at_two_speeds_with_slow_parts_determine_all_that_is_asked():
    assert whats(log_of(0.08 * np.sin(2 * np.pi * TIME) + 0.01 * np.sin(0.3 * TIME))) == []
    assert whats(log_of(strokes(0.1, 0.002)), log_of(strokes(0.02, 0.003))) == []


def test_one_speed_leaves_viscous_and_coulomb_friction_one_sum_and_a_second_is_proposed():
    (found,) = [one for one in shortcomings([log_of(strokes(0.05))], DRIVE) if "viscous" in one.what]
    assert found.what.endswith("only their sum at 50 mm/s")
    assert f"{50 * SECOND_SPEED:.3g} or at {50 / SECOND_SPEED:.3g} mm/s" in found.motion
    assert found.sentence.startswith("these logs do not determine viscous and Coulomb friction apart")
    assert not any("viscous" in what for what in whats(log_of(strokes(0.05)), fixed=("viscous",)))
    assert not any("viscous" in what for what in whats(log_of(strokes(0.05)), log_of(strokes(0.2))))


@pytest.mark.parametrize(("sign", "other"), [(1.0, "backwards"), (-1.0, "forwards")])
def test_one_direction_leaves_the_other_open(sign, other):
    away = sign * 0.02 * (1.1 + np.sin(2 * np.pi * TIME))
    assert whats(log_of(away))[0] == f"friction {other}, and a constant force beside friction"


def test_a_mass_whose_force_does_not_stand_out_is_not_determined():
    gentle = 0.02 * np.sin(0.6 * TIME)  # 12 mm/s2, 1.2 N
    assert "mass" in whats(log_of(gentle, noise=100.0))
    assert "mass" not in whats(log_of(gentle, noise=100.0), fixed=("mass",))
    assert "mass" not in whats(log_of(0.08 * np.sin(2 * np.pi * TIME), noise=100.0))


def test_without_slow_sliding_there_is_no_stribeck_curve():
    fast = strokes(0.2, 0.05)
    curve = "the Stribeck curve: breakaway_gap and stribeck_velocity"
    jump = np.where(np.abs(fast) < 0.049, 0.05 * np.sign(fast + 1e-9), fast)  # it reverses from one sample to the next
    falling = DRIVE.friction.stribeck_velocity.map(lambda _: 2e-3)
    friction = dataclasses.replace(DRIVE.friction, stribeck_velocity=falling)
    drive = dataclasses.replace(DRIVE, friction=friction)
    assert curve in whats(log_of(jump), drive=drive)
    assert curve not in whats(log_of(jump), drive=drive, fixed=("stribeck_velocity",))
    assert curve not in whats(log_of(fast), log_of(strokes(0.003)), drive=drive)


def test_a_table_at_rest_and_one_that_hardly_moves_determine_nothing_else():
    noise = 3e-8 * np.random.default_rng(1).standard_normal(len(TIME))
    resting = Log("rest", time=TIME, position=noise, command=50.0 * np.sin(TIME))
    (found,) = shortcomings([resting], DRIVE)
    assert found.what == "mass and friction"
    short = np.where(TIME < 0.4, 0.05 * np.sin(2 * np.pi * 2.5 * TIME), 0.0)
    assert shortcomings([log_of(short)], DRIVE)[0].why == "the table moves for 0.4 s only"


def test_the_motion_is_said_with_its_speeds_and_ways():
    shown = shown_motion([log_of(strokes(0.1, 0.01))], DRIVE)
    assert shown.seconds == pytest.approx(6.0, abs=0.1)
    assert shown.share_forwards == pytest.approx(0.5, abs=0.02)
    assert shown.speeds == pytest.approx((0.01, 0.1), rel=0.1)
    assert "10 to 100 mm/s" in shown.sentence
