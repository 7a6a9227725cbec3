"""Loads over time, and which of them the guides can carry."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive.errors import MotionError
from diffdrive.motion import load as loads

TIME = np.arange(5001) / 1000.0  # s


def test_constant_is_constant():
    np.testing.assert_array_equal(loads.constant(TIME, 1500.0), np.full(5001, 1500.0))


def test_step_changes_at_its_time_and_not_before():
    load = loads.step(TIME, at=2.0, to=500.0, before=-20.0)
    assert set(load[TIME < 2.0]) == {-20.0}
    assert set(load[TIME >= 2.0]) == {500.0}


def test_ramp_is_linear_between_its_ends_and_constant_outside():
    load = loads.ramp(TIME, start=2.5, end=3.5, to=10_000.0, before=1000.0)
    assert set(load[TIME <= 2.5]) == {1000.0}
    assert set(load[TIME >= 3.5]) == {10_000.0}
    rising = load[(TIME >= 2.5) & (TIME <= 3.5)]
    np.testing.assert_allclose(np.diff(rising), 9.0, rtol=1e-9)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-1e4, 1e4), min_size=1, max_size=8))
def test_piecewise_passes_through_its_points_and_never_beyond_them(values):
    times = np.linspace(0.5, 4.5, len(values)) if len(values) > 1 else np.array([1.0])
    load = loads.piecewise(TIME, times=times, loads=values)
    np.testing.assert_allclose(np.interp(times, TIME, load), values, atol=2e4 / 500)  # points may lie between samples
    assert load.max() <= max(values)
    assert load.min() >= min(values)
    assert (load[0], load[-1]) == (values[0], values[-1])


@settings(max_examples=40, deadline=None)
@given(st.floats(1.0, 1000.0), st.floats(0.0, 0.2), st.floats(0.1, 2.0), st.floats(0.1, 2.0))
def test_material_removal_balances_the_mass(workpiece, rate, first, second):
    cuts = [(0.5, 0.5 + first), (2.6, 2.6 + second)]
    load = loads.material_removal(TIME, workpiece=workpiece, removal_rate=rate, cuts=cuts)
    assert load[0] == pytest.approx(9.80665 * workpiece)
    assert (load[0] - load[-1]) / 9.80665 == pytest.approx(rate * (first + second), abs=1e-10)
    cutting = np.any([(start <= TIME) & (end >= TIME) for start, end in cuts], axis=0)
    flow = -np.gradient(load, TIME) / 9.80665  # kg/s
    inside = np.convolve(cutting, np.ones(3), "same") == 3
    outside = np.convolve(cutting, np.ones(3), "same") == 0
    np.testing.assert_allclose(flow[inside], rate, atol=1e-7)
    np.testing.assert_allclose(flow[outside], 0.0, atol=1e-7)


def test_material_removal_without_cuts_is_the_dead_weight():
    np.testing.assert_allclose(loads.material_removal(TIME, workpiece=10.0, removal_rate=1.0, cuts=[]), 98.0665)


def test_require_possible_passes_what_the_guides_carry(drive):
    load = loads.ramp(TIME, start=0.0, end=1.0, to=-15_200.0)  # down to lift-off exactly
    np.testing.assert_array_equal(loads.validated_load(drive, load, TIME), load)


@pytest.mark.parametrize(
    ("load", "says"),
    [
        (np.zeros(5000), r"shape \(5000,\), the motion 5001 samples: give one load per sample"),
        (np.zeros((5001, 1)), r"shape \(5001, 1\)"),
        (np.where(TIME < 1, 0.0, np.nan), r"not finite at t = 1 s: give newtons"),
        (np.where(TIME < 2, 0.0, -16_000.0), r"-16000 N at t = 2 s lifts the table off its guides.*above.*-15200 N"),
    ],
)
def test_require_possible_names_time_and_mend(drive, load, says):
    with pytest.raises(MotionError, match=says):
        loads.validated_load(drive, load, TIME)


NAN = float("nan")


@pytest.mark.parametrize(
    ("build", "says"),
    [
        (lambda: loads.step(TIME, at=NAN, to=1.0), "at = nan must be a finite time"),
        (lambda: loads.ramp(TIME, start=2.0, end=1.0, to=1.0), "times must increase, got"),
        (lambda: loads.ramp(TIME, start=1.0, end=2.0, to=NAN), "must be finite"),
        (lambda: loads.piecewise(TIME, times=[0.0, 1.0], loads=[1.0]), "as many times as loads"),
        (lambda: loads.piecewise(TIME, times=[], loads=[]), "at least one"),
        (lambda: loads.piecewise(TIME, times=[0.0, 0.0], loads=[1.0, 2.0]), "times must increase"),
        (lambda: loads.material_removal(TIME, workpiece=-1.0, removal_rate=0.0, cuts=[]), "workpiece = -1"),
        (lambda: loads.material_removal(TIME, workpiece=1.0, removal_rate=NAN, cuts=[]), "removal_rate = nan"),
        (lambda: loads.material_removal(TIME, workpiece=np.inf, removal_rate=0.0, cuts=[]), "workpiece = inf"),
        (lambda: loads.material_removal(TIME, workpiece=1.0, removal_rate=0.1, cuts=[(2.0, 1.0)]), "end after it"),
        (
            lambda: loads.material_removal(TIME, workpiece=1.0, removal_rate=1.0, cuts=[(1.0, 4.0)]),
            r"1 kg workpiece is used up at t = 2\.0\d* s: cut less",
        ),
    ],
)
def test_builders_refuse_nonsense_and_name_it(build, says):
    with pytest.raises(MotionError, match=says):
        build()
