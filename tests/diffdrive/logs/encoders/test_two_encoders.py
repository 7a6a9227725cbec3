"""Motor minus scale of simulated CNC axes: each part is found within its interval, and none where there is none."""

import dataclasses

import numpy as np
import pytest

import diffdrive as dd
from diffdrive.errors import ParameterError
from diffdrive.logs.checks.encoders import two_encoders

pytest.importorskip("numba", reason="the simulated axis is compiled")
from tests.support.cnc_axis import CncAxis, log_of, strokes
from tests.support.sound_log import SOUND

AXIS = CncAxis(per_turn=3e-6, linear=20e-6, drift=1e-6 / 60, delay=0.3e-3)


def of(**changes):
    axis = dataclasses.replace(AXIS, **changes)
    return axis, log_of(axis, seed=1, seconds=30.0)


def holds(estimate, truth):
    return estimate is not None and estimate.low <= truth <= estimate.high


def drawn(seed: int):
    """An axis, a trace and a motion at random; every fourth without backlash."""
    rng = np.random.default_rng(1000 + seed)
    backlash = (0.0, 3e-6, 10e-6, 100e-6)[seed % 4]
    trace = float(rng.choice([1e-3, 2e-3, 4e-3]))
    axis = CncAxis(
        backlash=backlash,
        wind_up=rng.uniform(5e-6, 40e-6),
        mass=rng.uniform(200.0, 1000.0),
        table_share=rng.uniform(0.3, 0.8),
        friction=rng.uniform(200.0, 1200.0),
        table_friction=rng.uniform(0.3, 0.9),
        presliding=rng.uniform(3e-6, 30e-6),
        per_turn=rng.uniform(1e-6, 5e-6),
        linear=rng.uniform(-20e-6, 20e-6),
        drift=rng.uniform(-1e-6, 1e-6) / 60,
        scatter=0.03 * backlash * float(rng.random() < 0.5),
        scale_step=float(rng.choice([0.1e-6, 0.2e-6, 0.5e-6, 1e-6])),
        trace=trace,
        gain=rng.uniform(20.0, 60.0),
        ripple=rng.uniform(0.0, 0.02),
        delay=trace * rng.uniform(-0.5, 0.5),
    )
    speed, stroke = [((0.005, 0.05), (0.01, 0.05)), ((0.02, 0.2), (0.05, 0.2)), ((0.05, 0.4), (0.05, 0.3))][seed % 3]
    return axis, log_of(axis, seed, rng.uniform(15.0, 40.0), stroke=stroke, speed=speed)


@pytest.mark.long
@pytest.mark.parametrize("backlash", [3e-6, 10e-6, 100e-6, 350e-6])
@pytest.mark.parametrize("wind_up", [5e-6, 20e-6])
def test_lost_motion_and_its_parts_are_found_before_any_fit(backlash, wind_up):
    axis, log = of(backlash=backlash, wind_up=wind_up)
    found = dd.compare_encoders(log)
    assert found.has_lost_motion
    assert found.reversal_error.value == pytest.approx(axis.reversal_error, rel=0.01)
    assert holds(found.backlash, backlash) or found.backlash.value == pytest.approx(backlash, rel=0.1)
    assert found.backlash.high < axis.reversal_error + 0.1e-6
    assert found.wind_up.value + found.backlash.value == pytest.approx(found.reversal_error.value)


@pytest.mark.long
@pytest.mark.parametrize("wind_up", [0.0, 5e-6, 20e-6, 40e-6])
def test_without_backlash_none_is_reported(wind_up):
    _, log = of(wind_up=wind_up)
    found = dd.compare_encoders(log)
    assert not found.has_backlash
    assert found.has_lost_motion is (wind_up > 0.0)
    assert [one for one in two_encoders(log, None) if one.severity != "note"] == []


@pytest.mark.long
def test_the_errors_of_screw_and_scale_are_found_beside_lost_motion():
    axis, log = of(backlash=10e-6)
    found = dd.compare_encoders(log)
    assert found.period == pytest.approx(axis.lead, rel=1e-3)
    assert found.per_turn.value == pytest.approx(axis.per_turn, rel=0.02)
    assert found.linear.value == pytest.approx(axis.linear, abs=0.3e-6)
    assert found.drift.value == pytest.approx(axis.drift, abs=0.1e-6 / 60)
    # the table's damping, half a second of its friction for each metre, winds the screw up beside
    assert found.delay.value == pytest.approx(axis.delay + 0.25 * axis.wind_up, abs=5e-6)


def test_no_error_per_turn_is_found_where_there_is_none():
    _, log = of(per_turn=0.0)
    assert dd.compare_encoders(log).per_turn is None


@pytest.mark.long
def test_the_interval_grows_with_the_scatter_of_the_reversals():
    same, scattered = (dd.compare_encoders(of(backlash=100e-6, scatter=scatter)[1]) for scatter in (0.0, 5e-6))
    assert same.scatter < 0.1e-6
    assert 1e-6 < scattered.scatter < 10e-6
    assert scattered.reversal_error.half_width > 10 * same.reversal_error.half_width
    assert holds(scattered.reversal_error, 110e-6)


def test_reversals_and_places_tell_where():
    axis, log = of(backlash=100e-6)
    found = dd.compare_encoders(log)
    assert len(found.reversals) > 10
    for one in found.reversals:
        assert one.error == pytest.approx(axis.reversal_error, abs=0.5e-6)
    for place in found.places:
        assert holds(place.error, axis.reversal_error) or abs(place.error.value - axis.reversal_error) < 0.3e-6


def test_mirrored_motion_has_the_same_lost_motion():
    _, log = of(backlash=10e-6)
    mirrored = log.replace(
        position=-log.position, motor_position=-log.motor_position, command=-log.command, reference=-log.reference
    )
    one, other = dd.compare_encoders(log), dd.compare_encoders(mirrored)
    assert one.reversal_error == pytest.approx(other.reversal_error, rel=1e-6)
    assert one.backlash == pytest.approx(other.backlash, rel=1e-6)


def test_the_unit_of_the_command_does_not_matter_to_lengths():
    _, log = of(backlash=10e-6)
    one, other = dd.compare_encoders(log), dd.compare_encoders(log.replace(command=-1e-3 * log.command))
    assert one.reversal_error.value == pytest.approx(other.reversal_error.value, rel=0.01)


def test_one_direction_has_no_reversal_error():
    axis = dataclasses.replace(AXIS, backlash=10e-6)
    reference = strokes(np.random.default_rng(1), 4.0)
    turned = int(np.argmax(np.abs(reference)))
    found = dd.compare_encoders(log_of(axis, 1, reference=reference[: min(turned, 80_000)]))
    assert found.reversal_error is None
    assert "does not slide in both directions" in found.headline()


def test_a_log_with_one_encoder_is_refused_in_one_line():
    _, log = of()
    with pytest.raises(ParameterError, match="no second encoder"):
        dd.compare_encoders(log.replace(motor_position=None))
    assert list(two_encoders(log.replace(motor_position=None), None)) == []


@pytest.mark.long
@pytest.mark.parametrize(("cases", "least"), [(8, 6), pytest.param(60, 52, marks=pytest.mark.slow)])
def test_intervals_hold_the_truth_as_often_as_they_say(cases, least):
    """At 95 % fewer than 52 of 60 are held once in 500 times, fewer than 6 of 8 once in 170."""
    held = dict.fromkeys(("reversal_error", "backlash", "per_turn", "linear", "drift"), 0)
    false_backlashes = 0
    for seed in range(cases):
        axis, log = drawn(seed)
        found = dd.compare_encoders(log)
        for name in held:
            held[name] += holds(getattr(found, name), getattr(axis, name))
        false_backlashes += axis.backlash == 0.0 and found.has_backlash
    assert min(held.values()) >= least, held
    assert false_backlashes <= 1


def test_a_motor_that_is_a_copy_of_the_table_differs_by_nothing_and_not_by_rounding():
    rng = np.random.default_rng(4)
    shaken = SOUND.position * (1.0 + np.finfo(float).eps * rng.integers(-1, 2, SOUND.position.size))
    found = dd.compare_encoders(dataclasses.replace(SOUND, motor_position=shaken))
    assert {name: tuple(one) for name, one, *_ in found.rows() if any(one)} == {}
    turned = np.where(np.gradient(SOUND.position) < 0.0, -1.0, 1.0)
    real = dd.compare_encoders(dataclasses.replace(SOUND, motor_position=shaken + 1e-12 * turned))
    assert real.reversal_error.value == pytest.approx(2e-12, rel=1e-3)  # a picometre is no rounding
