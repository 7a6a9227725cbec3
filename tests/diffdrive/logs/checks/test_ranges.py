"""Travel and speed against what an axis can be: in metres of a linear axis, in radians of a rotary one."""

import dataclasses
import re

import numpy as np
import pytest

import diffdrive as dd
from diffdrive.logs.checks.ranges import travel

LINEAR = dd.paper_axis()
ROTARY = dataclasses.replace(
    LINEAR,
    sheet=dd.DataSheet(kind="rotary"),
    limits=dataclasses.replace(LINEAR.limits, stroke=(-np.inf, np.inf), speed=np.inf),
)


def fast_log(speed: float) -> dd.Log:
    """To and fro at this speed."""
    time = 1e-3 * np.arange(2_000)
    position = speed * np.minimum(time, 2.0 - time)
    return dd.Log("log", time, position, np.zeros(len(time)), position)


@pytest.mark.parametrize(("speed", "fatal"), [(8.0, False), (300.0, False), (5e3, True)])
def test_a_table_that_turns_may_be_as_fast_as_motors_are(speed, fatal):
    """300 rad/s are 2865 rpm, which a motor has; 5000 rad/s are none's."""
    found = [one for one in travel(fast_log(speed), ROTARY) if one.severity == "fatal"]
    assert bool(found) is fatal
    assert all("rad/s" in one.message and "radians" in one.message for one in found)


def test_no_slide_is_faster_than_ten_metres_a_second():
    axis = dataclasses.replace(LINEAR, limits=ROTARY.limits)
    assert not [*travel(fast_log(8.0), axis)]
    (position, reference) = travel(fast_log(20.0), axis)
    assert re.search(r"moves at 2\d\S* m/s", position.message)
    assert "metres" in reference.message
