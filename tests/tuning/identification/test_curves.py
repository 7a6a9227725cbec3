"""Measured friction curves against the drive that they were simulated with, and on logs that hold none."""

from dataclasses import replace

import numpy as np
import pytest

from diffdrive import motion
from diffdrive.controllers import PD
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Sampling
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from tuning.identification.curves import hysteresis_curves, stribeck_curves
from tuning.identification.measured_friction import load_groups

SPEEDS = (0.0003, 0.001, 0.004, 0.010)
LOADS = (0.0, 8_000.0)
SAMPLING = Sampling(rate=4_000.0, substeps=4)


@pytest.fixture(scope="module")
def drive():
    return paper_drive(quantised=False)


@pytest.fixture(scope="module")
def logs(drive):
    """To and fro at several speeds under two loads, simulated."""
    made = []
    for load in LOADS:
        for speed in SPEEDS:
            there_and_back = motion.triangular(
                speed=speed, stroke=0.30 * speed, rounding=0.1, duration=2.0, rate=SAMPLING.rate
            )
            run = simulate_loop(
                drive, PD(paper_tracking(drive, PAPER_KP, PAPER_KD)), there_and_back, load=load, sampling=SAMPLING
            )
            assert run.status.ok
            made.append(Log(f"{speed:g}", run.time, run.position, run.command, load=run.load))
    return made


def constant_speed(speed, force, seconds=1.0, rate=1_000.0):
    time = np.arange(round(seconds * rate)) / rate
    return Log("cruise", time, speed * time, np.full_like(time, force))


def test_the_stribeck_curve_is_the_steady_friction_of_the_drive(drive, logs):
    found = stribeck_curves(logs, drive)
    assert [curve.load for curve in found.curves] == pytest.approx(LOADS)
    for curve in found.curves:
        assert len(curve.velocity) >= 2 * len(SPEEDS)
        assert np.all(np.diff(curve.velocity) > 0)
        np.testing.assert_allclose(curve.friction, curve.model, rtol=0.01)
        at_speed = curve.count > 500
        assert at_speed.sum() == 2 * len(SPEEDS)
        np.testing.assert_allclose(curve.friction[at_speed], curve.model[at_speed], rtol=0.002)
        velocity = curve.velocity[at_speed]
        expected = [
            float(steady_friction(drive.friction, v, curve.load) + drive.plant.damping.towards(v) * v) for v in velocity
        ]
        np.testing.assert_allclose(curve.model[at_speed], expected, rtol=0.01)


def test_a_wrong_model_is_seen_beside_the_measured_curve(drive, logs):
    stiffer = replace(drive, friction=replace(drive.friction, viscous=2_500.0))
    for curve in stribeck_curves(logs, stiffer).curves:
        fast = np.abs(curve.velocity) > 5e-3
        assert np.all(np.abs(curve.model[fast]) > np.abs(curve.friction[fast]) + 2.0)


def test_a_hysteresis_curve_leads_from_one_friction_to_the_other(drive, logs):
    found = hysteresis_curves(logs, drive)
    assert [(curve.load, curve.direction) for curve in found.curves] == [(w, side) for w in LOADS for side in (1, -1)]
    for curve in found.curves:
        assert curve.reversals >= 2
        assert np.all(curve.lower <= curve.median)
        assert np.all(curve.median <= curve.upper)
        assert curve.direction * curve.median[-1] > 60.0
        assert curve.direction * curve.median[0] < 0.5 * abs(curve.median[-1])  # the bristle still pushes back
        assert curve.displacement[0] == 0.0


def test_the_bristle_is_seen_after_a_reversal(drive):
    """A quasi-static reversal rises from -F to F over some bristle lengths, as LuGre friction does exactly."""
    friction = replace(drive.friction, breakaway_gap=1e-3, viscous=0.0, bristle_damping=0.0, bristle_stiffness=1e5)
    soft = replace(drive, friction=friction, plant=replace(drive.plant, damping=0.0, mass=1e-6))
    time = np.arange(8_000) / 1_000.0
    position = 0.01 * np.abs(np.mod(time / 2.0, 2.0) - 1.0)  # 5 mm/s to and fro
    position = np.convolve(np.pad(position, 50, mode="edge"), np.hanning(101) / np.hanning(101).sum(), mode="valid")
    velocity = np.gradient(position, time)
    screw = {+1: 63.43 + 3.66e-4 * 15_200, -1: 64.95 + 3.66e-4 * 15_200}
    force, bristle = np.empty_like(time), 0.0
    for k, v in enumerate(velocity):
        force[k] = 1e5 * bristle
        level = screw[1 if v >= 0 else -1]
        bristle = np.sign(v) * level / 1e5 + (bristle - np.sign(v) * level / 1e5) * np.exp(-1e5 * abs(v) / level * 1e-3)
    curves = hysteresis_curves(Log("soft", time, position, force), soft, reach=4e-3).curves
    forward = next(curve for curve in curves if curve.direction == 1)
    expected = screw[1] - (screw[1] + screw[-1]) * np.exp(-1e5 * forward.displacement / screw[1])
    np.testing.assert_allclose(forward.median, expected, atol=3.0)


@pytest.mark.long
def test_the_error_of_a_bin_is_that_of_its_passes(drive):
    """Passes with another friction each: the spread between them counts, not the number of samples."""
    rng = np.random.default_rng(0)
    offsets = 5.0 * rng.standard_normal(12)
    made = [constant_speed(0.01, 100.0 + offset) for offset in offsets]
    (curve,) = stribeck_curves(made, drive).curves
    assert curve.passes.tolist() == [12]
    assert curve.friction[0] == pytest.approx(100.0 + offsets.mean())
    assert curve.standard_error[0] == pytest.approx(offsets.std(ddof=1) / np.sqrt(12))
    (single,) = stribeck_curves(made[0], drive).curves
    assert np.isnan(single.standard_error).all()


def test_the_inertia_and_the_constant_force_are_taken_off(drive):
    tilted = replace(drive, plant=replace(drive.plant, constant_force=12.0))
    time = np.arange(4_000) / 1_000.0
    position = 0.02 * time + 1e-4 * np.sin(2 * np.pi * time)
    acceleration = -1e-4 * (2 * np.pi) ** 2 * np.sin(2 * np.pi * time)
    log = Log("tilted", time, position, 100.0 * acceleration + 80.0 - 12.0)
    (curve,) = stribeck_curves(log, tilted).curves
    np.testing.assert_allclose(curve.friction, 80.0, atol=0.01)


def test_rest_and_acceleration_alone_give_no_stribeck_curve(drive):
    time = np.arange(2_000) / 1_000.0
    rest = Log("rest", time, np.full(2_000, 0.1), np.full(2_000, 20.0))
    shaken = Log("shaken", time, 0.01 * np.sin(30.0 * time), np.zeros(2_000))
    for log in (rest, shaken):
        found = stribeck_curves(log, drive)
        assert found.curves == ()
        assert "no stretch of steady motion" in found.notes[-1]


def test_a_table_that_rests_after_a_motion_adds_no_slow_bins(drive):
    time = np.arange(3_000) / 1_000.0
    log = Log("stop", time, 0.01 * np.minimum(time, 1.5), np.where(time < 1.5, 100.0, 30.0))
    (curve,) = stribeck_curves(log, drive).curves
    assert curve.velocity == pytest.approx([0.01], rel=0.1)
    assert curve.friction == pytest.approx([100.0], rel=0.05)


def test_no_reversal_gives_no_hysteresis_curve(drive):
    time = np.arange(2_000) / 1_000.0
    rest = Log("rest", time, np.full(2_000, 0.1), np.full(2_000, 20.0))
    noisy = replace(rest, position=0.1 + 1e-8 * np.random.default_rng(1).standard_normal(2_000))
    for log in (constant_speed(0.01, 100.0), rest, noisy):
        found = hysteresis_curves(log, drive)
        assert found.curves == ()
        assert "nowhere reverses" in found.notes[-1]


def test_a_stop_without_reversal_is_no_reversal(drive):
    time = np.arange(4_000) / 1_000.0
    noise = 1e-8 * np.random.default_rng(2).standard_normal(4_000)
    position = 0.01 * (np.minimum(time, 1.0) + np.maximum(time - 3.0, 0.0)) + noise
    found = hysteresis_curves(Log("stop and go", time, position, np.zeros(4_000)), drive)
    assert found.curves == ()


def test_logs_too_short_are_refused(drive):
    for curves in (stribeck_curves, hysteresis_curves):
        with pytest.raises(LogError, match="too short"):
            curves(constant_speed(0.01, 100.0, seconds=0.1), drive)


def test_loads_are_grouped_into_levels():
    assert load_groups(np.array([0.0, 8_010.0, 5.0, 7_990.0, 3_000.0])).tolist() == [0, 2, 0, 2, 1]
    assert load_groups(np.zeros(3)).tolist() == [0, 0, 0]
