"""Where a gap lies: shares of lines, what they are locked to, and how often chance alone is told as significant."""

import dataclasses
import re
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal

from diffdrive.logs import Log
from tests.support.sound_log import DRIVE, RATE
from tuning.diagnosis.diagnose import logged_of
from tuning.diagnosis.filter.effect_signals import Trajectory
from tuning.diagnosis.filter.ekf import DISTURBANCE_TIME
from tuning.diagnosis.gap.gap import ForceGap
from tuning.diagnosis.gap.lines import lines_in_position, lines_in_time, told_apart
from tuning.diagnosis.gap.where import FAINT, SIGNIFICANT, Region, localise, ranked
from tuning.diagnosis.hypotheses.catalogue import candidates
from tuning.diagnosis.hypotheses.excitation import excitation_deficits
from tuning.diagnosis.hypotheses.setting import Setting, setting
from tuning.diagnosis.selection.starting_points import starting_points
from tuning.identification.prediction import Lanes

PITCH = 1.25e-3  # m
SETTING = Setting(100.0, 70.0, 4e-4, 2e3, 0.0, 3e-6, 1.0 / RATE, 9.0, -0.02, 0.02, 0.06, 200.0, 200.0)


def triangle(time, speed, stroke):
    """Position (m) to and fro at one speed."""
    return stroke * (0.5 + 0.5 * scipy.signal.sawtooth(np.pi * speed / stroke * time, 0.5))


def located(force, position, lost=0.0, **more):
    """The regions of a force (N) along a position (m), with everything counted."""
    ones, flat = np.ones((1, len(force))), np.zeros((1, len(force)))
    velocity = np.gradient(position)[None] * RATE
    gap = ForceGap(force[None], Trajectory(position[None], velocity, flat, flat, flat), force[None] ** 2, ones, lost)
    lanes = Lanes(*(jnp.asarray(one) for one in (position[None], flat, flat, flat, ones)), velocity=jnp.zeros(1))
    return localise(gap, lanes, (0,), RATE, **more)


def test_of_a_table_that_rests_much_neither_way_has_more_than_its_share():
    """As much is missing both ways, and nothing at rest: motion is where it lies, and no direction and no speed."""
    time = np.arange(20_000) / RATE
    moving = np.minimum(time % 2.0, 1.0)  # it goes for a second and rests for one
    position = 0.01 * (1.0 - np.cos(2 * np.pi * (moving + 0.5 * np.floor(time / 2.0)))) / 2.0
    force = np.random.default_rng(5).standard_normal(len(time)) * (np.abs(np.gradient(position)) > 0.0)
    found = {(one.dimension, one.region): one for one in located(force, position)}
    ways = [found["direction", way] for way in ("positive", "negative")]
    in_motion = 1.0 - found["phase", "rest"].share
    assert sum(one.share for one in ways) == pytest.approx(in_motion, abs=0.02)
    assert sum(one.expected for one in ways) == pytest.approx(in_motion, abs=0.02)
    assert all(one.p_value > SIGNIFICANT for one in ways)
    assert re.search(r"lies in positive direction, where \d+ % would, were it alike in all motion", ways[0].says)
    assert all(one.p_value > SIGNIFICANT for (dimension, _), one in found.items() if dimension == "speed")
    assert found["phase", "rest"].share < 0.1 < found["phase", "rest"].expected


def test_a_lost_filters_force_has_no_lines_to_tell():
    time = np.arange(20_000) / RATE
    position, ripple = triangle(time, 0.02, 0.03), np.sin(2 * np.pi * 83.0 * time)
    assert any(one.dimension == "frequency" for one in located(ripple, position))
    assert not any(one.dimension == "frequency" for one in located(ripple, position, lost=0.5))


def standing(force, position):
    """The lines of a force that stand for themselves and are worth telling."""
    force, position = force[None], position[None]
    counts = np.ones(force.shape)
    lines = [*lines_in_time(force, RATE), *lines_in_position(force, position, counts)]
    lines = [one for one in lines if one.p_value < SIGNIFICANT]
    found = told_apart(lines, force, position, np.gradient(position, axis=1) * RATE, counts, RATE)
    return [one for one in found if one.line.share > FAINT]


@pytest.mark.parametrize("seconds", [3.0, 10.0, 30.0])
@pytest.mark.parametrize(("noise", "share"), [(0.0, 1.0), (1.0, 2.0 / 3.0), (2.0, 1.0 / 3.0)])
def test_a_ripple_has_its_share_of_the_energy(seconds, noise, share):
    time = np.arange(round(seconds * RATE)) / RATE
    position = triangle(time, 0.031, 0.04)
    force = 2.0 * np.sin(2 * np.pi * position / PITCH) + noise * np.random.default_rng(3).standard_normal(len(time))
    line = lines_in_position(force[None], position[None], np.ones((1, len(time))))[0]
    assert line.value == pytest.approx(PITCH, rel=0.02)
    assert line.share == pytest.approx(share, rel=0.15)


def test_a_ripple_that_part_of_the_log_sees_has_a_part_of_the_energy():
    time = np.arange(20_000) / RATE
    position = triangle(time, 0.02, 0.03)
    ripple, other = np.sin(2 * np.pi * position / PITCH), np.sin(2 * np.pi * 83.0 * time)
    line = lines_in_position((ripple + other)[None], position[None], np.ones((1, len(time))))[0]
    assert line.share == pytest.approx(0.5, abs=0.05)


def test_the_strongest_line_is_among_those_found_though_the_motion_widens_its_foot():
    """A scale's signal period, met at speeds at which its samples alias: each of its shadows stands out more."""
    speed = np.concatenate(
        [
            [0.0] * 300 + [one] * round(way / one * RATE)
            for way, one in ((0.06, 0.047), (-0.03, -0.011), (-0.03, -0.061), (0.02, 0.023), (-0.02, -0.029))
        ]
    )
    position = np.cumsum(np.convolve(speed, np.full(100, 0.01), mode="same")) / RATE
    period = 8.826e-6
    error = np.sin(2 * np.pi * position / period) + 0.3 * np.random.default_rng(4).standard_normal(len(position))
    lines = lines_in_position(error[None], position[None], np.ones((1, len(position))), 1e-6, 5e-4)
    best = max(lines, key=lambda one: one.share)
    assert best.value == pytest.approx(period, rel=1e-4)
    assert best.share > 0.7


def test_a_ripple_at_two_speeds_is_locked_to_position_alone():
    time = np.arange(16_000) / RATE
    slow = time < 6.0
    position = np.where(slow, 0.01 * time, 0.06 + 0.03 * (time - 6.0))
    noise = 0.3 * np.random.default_rng(1).standard_normal(len(time))
    found = standing(2.0 * np.sin(2 * np.pi * position / PITCH) + noise, position)
    assert [one.line.dimension for one in found] == ["position"]
    assert found[0].line.value == pytest.approx(PITCH, rel=0.01)
    assert found[0].rival is None
    assert found[0].line.share == pytest.approx(0.96, abs=0.02)


def test_a_vibration_at_two_speeds_is_locked_to_time_alone():
    time = np.arange(16_000) / RATE
    position = np.where(time < 6.0, 0.01 * time, 0.06 + 0.03 * (time - 6.0))
    noise = 0.3 * np.random.default_rng(1).standard_normal(len(time))
    force = 2.0 * np.sin(2 * np.pi * 8.0 * time) + noise
    counts = np.ones((1, len(time)))
    in_place = [one for one in lines_in_position(force[None], position[None], counts) if one.p_value < SIGNIFICANT]
    assert in_place  # which is why it must be decided
    found = standing(force, position)
    assert [one.line.dimension for one in found] == ["frequency"]
    assert found[0].line.value == pytest.approx(8.0, abs=0.05)
    assert found[0].rival is None


def test_a_ripple_and_a_vibration_at_once_are_both_told():
    time = np.arange(16_000) / RATE
    position = np.where(time < 6.0, 0.01 * time, 0.06 + 0.03 * (time - 6.0))
    found = standing(np.sin(2 * np.pi * 13.0 * time) + 1.5 * np.sin(2 * np.pi * position / PITCH), position)
    assert [one.line.dimension for one in found[:2]] == ["position", "frequency"]
    assert all(one.rival is None for one in found[:2])


def test_a_ripple_that_the_filter_sees_late_is_still_locked_to_position():
    time = np.arange(16_000) / RATE
    position = 0.02 * np.sin(3.0 * time) + 0.003 * np.sin(11.0 * time)
    late = position - 4e-3 * np.gradient(position) * RATE
    noise = 0.3 * np.random.default_rng(1).standard_normal(len(time))
    found = standing(2.0 * np.sin(2 * np.pi * late / PITCH) + noise, position)
    assert found[0].line.dimension == "position"
    assert found[0].line.share > 0.9


@pytest.mark.parametrize("truth", ["ripple", "vibration"])
def test_at_one_speed_a_ripple_cannot_be_told_from_a_vibration(truth):
    time = np.arange(16_000) / RATE
    position = 0.01 * time
    angle = 2 * np.pi * (position / PITCH if truth == "ripple" else 8.0 * time)
    force = 2.0 * np.sin(angle) + 0.3 * np.random.default_rng(1).standard_normal(len(time))
    told = [one for one in located(force, position) if "distinguished from" in one.says]
    assert len(told) == 1
    assert "at one speed (10 mm/s)" in told[0].says
    assert "locked" not in told[0].says


@pytest.mark.long
def test_periods_are_told_per_turn_where_the_lead_is_known():
    time = np.arange(16_000) / RATE
    position = 0.02 * np.sin(3.0 * time) + 0.003 * np.sin(11.0 * time)
    force = 2.0 * np.sin(2 * np.pi * position / PITCH) + np.random.default_rng(1).standard_normal(len(time))
    known, unknown = (located(force, position, **more)[0] for more in ({"lead": 5e-3}, {}))
    assert known.region == unknown.region == "period of 1.25 mm"
    assert "locked to position" in known.says
    assert "(4 to a turn of the screw)" in known.says
    assert "turn" not in unknown.says


def coloured(seed, count):
    """White innovations, lasting as the missing force does."""
    ar1_coeff = np.exp(-1.0 / (DISTURBANCE_TIME * RATE))
    return scipy.signal.lfilter([1.0], [1.0, -ar1_coeff], np.random.default_rng(seed).standard_normal(count))


@pytest.mark.long
def test_in_noise_hardly_any_region_is_significant():
    time = np.arange(10_000) / RATE
    position = 0.02 * np.sin(3.0 * time) + 0.003 * np.sin(11.0 * time)
    noise = np.stack([coloured(100 + k, len(time)) for k in range(2)], axis=1)[None]
    alarms = 0
    for seed in range(16):
        force = coloured(seed, len(time))
        white = np.random.default_rng(seed).standard_normal((1, len(time))) ** 2
        flat, ones = np.zeros((1, len(time))), np.ones((1, len(time)))
        gap = ForceGap(
            force[None], Trajectory(position[None], np.gradient(position)[None] * RATE, flat, flat, flat), white, ones
        )
        lanes = Lanes(*(jnp.asarray(one) for one in (position[None], flat, flat, flat, ones)), velocity=jnp.zeros(1))
        alarms += any(one.p_value < SIGNIFICANT for one in localise(gap, lanes, (0,), RATE, noise=noise))
    assert alarms <= 2


def test_a_band_is_held_against_what_the_noise_makes_of_it():
    time = np.arange(10_000) / RATE
    position = 0.02 * np.sin(3.0 * time)
    noise, hum = np.random.default_rng(5).standard_normal((2, 10_000))
    b, a = scipy.signal.butter(2, [12.0, 25.0], "bandpass", fs=RATE)
    force = noise + 3.0 * scipy.signal.lfilter(b, a, hum)
    alone = np.random.default_rng(6).standard_normal((1, 10_000, 2))
    found = {one.region: one for one in located(force, position, noise=alone) if one.dimension == "frequency"}
    assert found["10 to 30 Hz"].p_value < 1e-6
    assert found["30 to 100 Hz"].p_value > 0.05
    found = {one.region: one for one in located(force, position) if one.dimension == "frequency"}
    assert found["10 to 30 Hz"].p_value == 1.0


def region(share, expected, p_value):
    return Region("phase", f"{share}", share, expected, p_value, "")


def test_regions_are_paid_for_and_the_significant_ones_come_first():
    many = [region(0.9, 0.1, 0.04), *[region(0.3, 0.3, 0.5)] * 20, region(0.4, 0.3, 1e-5), region(0.6, 0.1, 1e-4)]
    found = ranked(many)
    assert [one.share for one in found[:3]] == [0.6, 0.4, 0.9]
    assert found[0].p_value == pytest.approx(1e-4 * 23 / 2)
    assert found[2].p_value > SIGNIFICANT
    assert ranked(many[-1:], unlisted=9)[0].p_value == pytest.approx(1e-3)
    assert ranked([]) == []


def test_regions_from_elsewhere_come_behind_the_others_and_neither_pay_for_the_other():
    """As sure as they may be of what explains a gap, where it lies is no surer for it."""
    time = np.arange(6_000) / RATE
    force, position = np.random.default_rng(0).standard_normal(len(time)), 0.02 * np.sin(3.0 * time)
    others = [Region("subsystem", f"{k}", 0.8, 0.0, 0.0, "") for k in range(9)]
    others.append(Region("subsystem", "sensor", 0.1, 0.0, 0.04, ""))
    alone, beside = located(force, position), located(force, position, others=others)
    assert beside[: len(alone)] == alone
    assert [one.p_value for one in beside[len(alone) :]] == pytest.approx([0.0] * 9 + [0.04])


def test_times_are_those_of_the_log_where_it_has_a_gap():
    time = np.arange(4_000) / RATE
    force = np.random.default_rng(0).standard_normal((2, len(time)))
    position = np.stack([0.02 * np.sin(3.0 * time)] * 2)
    flat, ones = np.zeros(force.shape), np.ones(force.shape)
    gap = ForceGap(force, Trajectory(position, np.gradient(position, axis=1) * RATE, flat, flat, flat), force**2, ones)
    lanes = Lanes(*(jnp.asarray(one) for one in (position, flat, flat, flat, ones)), velocity=jnp.zeros(2))
    times = [one.region for one in localise(gap, lanes, (0, 0), RATE, starts=[0.0, 7.0]) if one.dimension == "time"]
    assert any(one.endswith("9 s") for one in times)

    burst = np.sin(2 * np.pi * 60.0 * time) * np.stack([np.abs(time - 1.0) < 0.05, np.abs(time - 1.0) < 0.5])
    logged = SimpleNamespace(
        logs=1, owner=(0, 0), starts=jnp.asarray([0.0, 7.0]), sampling=SimpleNamespace(rate=RATE), lanes=lanes
    )
    filtered = SimpleNamespace(kalman_gain=(flat, flat), innovation=flat, disturbance=burst)
    drive = SimpleNamespace(plant=SimpleNamespace(mass=100.0))
    candidate = next(one for one in candidates(SETTING) if one.name == "process_force")
    point = starting_points(
        SimpleNamespace(model=SimpleNamespace(logged=logged), filtered=filtered, drive=drive), candidate
    )[0]
    assert point["frequency"][0] == pytest.approx(60.0, abs=0.5)
    assert (point["start"][0], point["end"][0]) == (pytest.approx(7.5, abs=0.2), pytest.approx(8.5, abs=0.2))


def saturated(command, limit):
    """Whether a log with such a command (N) counts as saturated, on a drive with this limit (N)."""
    drive = dataclasses.replace(DRIVE.drive, actuator=dataclasses.replace(DRIVE.drive.actuator, force_limit=limit))
    time = np.arange(len(command)) / RATE
    position = 0.02 * np.sin(3.0 * time)
    log = Log("log", time=time, position=position, command=command, reference=position, load=np.zeros(len(time)))
    logged = logged_of(drive, [log])
    found = excitation_deficits(logged, setting(logged.drive, logged.lanes, 1.0 / RATE))
    return any("limit" in one.why for one in found)


def test_a_command_at_the_limit_is_saturated_however_large_or_noisy_it_is():
    time = np.arange(8_000) / RATE
    room = np.random.default_rng(2)
    asked = 2_000.0 * np.cos(3.0 * time) + 50.0 * room.standard_normal(len(time))
    measured = 300.0 * np.sign(np.cos(3.0 * time)) * (1.0 + 0.005 * room.standard_normal(len(time)))
    assert saturated(asked, 300.0)
    assert saturated(measured, 300.0)
    assert saturated(measured, None)
    assert not saturated(asked, 5_000.0)
    assert not saturated(asked, None)
    assert not saturated(measured, 400.0)  # a force that is the same throughout, but within the limit
