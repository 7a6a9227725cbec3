"""What effects cost of an axis's accuracy, and which is to be mended first."""

import dataclasses
import json

import numpy as np
import pytest

import experiments
import tuning
from diffdrive.controllers import UnknownController
from diffdrive.effects.forces import ConstantForce
from diffdrive.effects.scale import LeadError
from diffdrive.effects.transmission import Backlash
from diffdrive.errors import MotionError, ParameterError
from diffdrive.paper import paper_axis

DRIVE = paper_axis("pd+fc+ls", quantised=False)  # which settles within a few nanometres of its target
STROKE = (-0.02, 0.02)
TEST = {"stroke": STROKE, "speed": 0.1, "acceleration": 1.0, "seed": None}
SLOPE = 3e-4
SCALE = LeadError(linear=SLOPE)
SCREW = Backlash(gap=6e-6, frequency=400.0, damping=0.08, motor_share=0.4, table_friction=0.5)


@pytest.fixture(scope="module")
def found():
    return tuning.severity(DRIVE.with_effects(SCALE, SCREW), tolerance=3e-6, **TEST)


def test_a_scale_that_reads_too_little_costs_its_slope_times_the_targets_span(found):
    alone = tuning.severity(DRIVE.with_effects(SCALE), **TEST)
    span = np.ptp(tuning.accuracy.positioning.targets_within(*STROKE))
    assert alone.as_it_is.accuracy - alone.sound.accuracy == pytest.approx(SLOPE * span, rel=0.05)
    assert alone.as_it_is.reversal_error == pytest.approx(alone.sound.reversal_error, abs=0.1e-6)
    assert alone.without[0].accuracy == pytest.approx(alone.sound, rel=1e-6)


def test_of_two_the_one_is_mended_and_the_other_stays(found):
    mended = {one.effect: one.accuracy for one in found.without}
    assert set(mended) == {"lead_error", "backlash", "all"}
    assert mended["lead_error"].accuracy < 0.3 * found.as_it_is.accuracy  # the scale is beside the table
    assert mended["backlash"].hysteresis < 0.5 * found.as_it_is.hysteresis
    assert mended["backlash"].accuracy == pytest.approx(found.as_it_is.accuracy, rel=0.2)


def test_the_part_to_look_at_first_and_what_is_beyond_the_tolerance_are_said(found):
    assert found.first.effect == found.by_gain[0].effect == "lead_error"
    assert found.first.parts == ("sensor",)
    assert found.beyond == ("positioning accuracy A", "circular deviation G")
    assert "Look at the sensor first: lead_error costs most." in found.summary()
    assert "beyond 3 µm" in repr(found)
    assert found.status.ok


def test_what_an_observer_makes_up_for_costs_nothing_at_rest():
    """A constant force: in motion it is taken for load, which has the wrong sign after each reversal."""
    alone = tuning.severity(DRIVE.with_effects(ConstantForce(force=20.0)), **TEST)
    assert alone.as_it_is.accuracy < 0.01e-6
    assert alone.as_it_is.circular_deviation > 3.0 * alone.sound.circular_deviation


def test_an_effect_of_next_to_no_cost_is_not_looked_for_first():
    """A ten-millionth of a newton: what is gained by it is rounding."""
    alone = tuning.severity(DRIVE.with_effects(ConstantForce(force=-1e-7)), **TEST)
    assert alone.first is None
    assert "No single effect costs accuracy" in alone.summary()


@pytest.mark.long
def test_a_loop_that_settles_slowly_is_measured_at_rest():
    """K_v of 1 m/min/mm: after 0.3 s it is tens of micrometres off yet."""
    slow = paper_axis("cascade", quantised=False).with_gains(kp=16.67, ki=1e7)
    found = tuning.severity(slow.with_effects(SCALE), **TEST)
    assert found.sound.accuracy < 0.01e-6
    assert found.notes == ()


def test_it_is_reported_as_any_result_is(found, tmp_path):
    experiments.report(found, tmp_path)
    assert {"severity.json", "severity.csv", "severity.png"} <= {one.name for one in tmp_path.iterdir()}
    assert "Deviation of the radius over the angle" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert np.ptp(found.circles["none"], axis=1).max() == pytest.approx(found.as_it_is.circular_deviation, rel=0.01)


def test_it_is_saved_with_every_number(found, tmp_path):
    told = json.loads(found.save(tmp_path).read_text())
    assert told["schema"] == "severity/1"
    assert told["as_it_is_m"]["accuracy"] == found.as_it_is.accuracy
    assert [one["effect"] for one in told["without"]] == ["backlash", "lead_error", "all"]
    assert told["first"] == "lead_error"


def test_the_progress_ends_at_its_total():
    calls = []
    tuning.severity(DRIVE.with_effects(SCALE), progress=lambda *one: calls.append(one), **TEST)
    assert calls[-1] == ("severity", 3, 3)


@pytest.mark.parametrize(
    ("axis", "more", "says"),
    [
        (DRIVE, {}, "the axis has no unmodelled effect"),
        (
            dataclasses.replace(DRIVE.with_effects(SCALE), controller=UnknownController()),
            {},
            "controller is not stated",
        ),
        (DRIVE.with_effects(SCALE), {"speed": None}, "give speed, or state limits.speed"),
        (DRIVE.with_effects(SCALE), {"stroke": (0.02, 0.01)}, "stroke: must be above 0"),
        (DRIVE.with_effects(SCALE), {"tolerance": 0.0}, "tolerance: must be above 0"),
    ],
)
def test_what_cannot_be_tested_is_said(axis, more, says):
    with pytest.raises(ParameterError, match=says):
        tuning.severity(axis, **(TEST | more))


def test_a_motion_beyond_the_axis_is_refused():
    with pytest.raises(MotionError, match="stroke"):
        tuning.severity(DRIVE.with_effects(SCALE), **(TEST | {"stroke": (-0.2, 0.2)}))
