"""Logs whose columns are in the motor's units: read equal to their twins in SI."""

import dataclasses
import math

import numpy as np
import pytest

import diffdrive as dd
from diffdrive.errors import LogError
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.model.data_sheet import DataSheet

SHEET = DataSheet(lead=10e-3, gear_ratio=2.0, rated_torque=5.0, rated_current=4.0, encoder_counts=10_000.0)
R = 10e-3 / (4.0 * math.pi)  # m per rad of the motor
AXIS = dataclasses.replace(dd.paper_axis(), sheet=SHEET, mapping=ColumnMapping())
TIME = np.arange(200) / AXIS.rate
POSITION, COMMAND = 0.01 * np.sin(40.0 * TIME), 300.0 * np.cos(40.0 * TIME)
VELOCITY, CURRENT = 0.4 * np.cos(40.0 * TIME), 2.0 * np.cos(40.0 * TIME)
TWIN = dd.read_log(
    {"time": TIME, "position": POSITION, "reference": POSITION, "command": COMMAND, "velocity": VELOCITY,
     "current": CURRENT},
    AXIS,
)  # fmt: skip
DEGREES, TURNS, COUNTS = math.radians(1.0) * R, 2.0 * math.pi * R, 2.0 * math.pi * R / 10_000
SHOP = {
    "position": POSITION / DEGREES, "reference": POSITION / TURNS, "command": -COMMAND * R / 0.05,
    "velocity": VELOCITY * 60.0 / TURNS, "current": 25.0 * CURRENT,
}  # fmt: skip
UNITS = {"position": "deg", "reference": "rev", "command": "-%", "velocity": "rpm", "current": "%"}


def assert_is_the_twin(log):
    assert list(log.channels) == list(TWIN.channels)
    for name, signal in TWIN.channels.items():
        np.testing.assert_allclose(getattr(log, name), signal, rtol=1e-13, atol=1e-15)


def test_a_log_in_the_shops_units_is_its_twin_in_si():
    assert_is_the_twin(dd.read_log({"time": TIME, **SHOP}, AXIS, units=UNITS))
    stated = dataclasses.replace(AXIS, mapping=ColumnMapping(units=UNITS, sheet=SHEET))
    assert_is_the_twin(dd.read_log({"time": TIME, **SHOP}, stated))


def test_headers_state_them_as_well():
    named = {
        "position [deg]": SHOP["position"], "reference (rev)": SHOP["reference"], "command [%]": -SHOP["command"],
        "velocity_rpm": SHOP["velocity"], "current [%]": SHOP["current"],
    }  # fmt: skip
    assert_is_the_twin(dd.read_log({"time": TIME, **named}, AXIS))


@pytest.mark.parametrize(
    ("unit", "worth"), [("A", 1.25 / R), ("N*m", 1.0 / R), ("Nm", 1.0 / R), ("50 mA", 0.0625 / R), ("N", 1.0)]
)
def test_every_unit_of_a_command(unit, worth):
    log = dd.read_log({"time": TIME, "position": POSITION, "command": COMMAND / worth}, AXIS, units={"command": unit})
    np.testing.assert_allclose(log.command, COMMAND, rtol=1e-13, atol=1e-12)


def test_counts_of_the_encoder():
    log = dd.read_log(
        {"time": TIME, "position": POSITION / COUNTS, "command": COMMAND}, AXIS, units={"position": "count"}
    )
    np.testing.assert_allclose(log.position, POSITION, rtol=1e-13, atol=1e-15)


def test_a_force_per_ampere_comes_before_the_sheets():
    mapping = ColumnMapping(units={"command": "A"}, force_per_ampere=35.0, sheet=SHEET)
    assert mapping.conversion("command", "A", "here").factor == 35.0
    stated = ColumnMapping(sheet=SHEET).overridden({}, {"command": "A", "force_per_ampere": "1.3 N*m/A"}, {})
    assert stated.conversion("command", "A", "here").factor == pytest.approx(1.3 / R)


def test_a_rotary_axis_is_logged_in_its_own_angles():
    sheet = DataSheet(kind="rotary", gear_ratio=90.0, rated_torque=5.0)
    axis = dataclasses.replace(AXIS, sheet=sheet)
    columns = {"time": TIME, "position [deg]": np.degrees(POSITION), "command [%]": COMMAND / 4.5}
    log = dd.read_log(columns, axis)
    np.testing.assert_allclose(log.position, POSITION, rtol=1e-13, atol=1e-15)
    np.testing.assert_allclose(log.command, COMMAND, rtol=1e-13, atol=1e-12)
    with pytest.raises(LogError, match=r"column 'position \[mm\]': 'mm' is no unit of the position"):
        dd.read_log({"time": TIME, "position [mm]": POSITION, "command": COMMAND}, axis)


def test_what_the_sheet_must_say_is_named():
    columns = {"time": TIME, "position": POSITION, "command [%]": COMMAND}
    with pytest.raises(LogError, match=r"'%' is no unit of the command without \[axis\] rated_torque: write one"):
        dd.read_log(columns, dataclasses.replace(AXIS, sheet=DataSheet(lead=5e-3)))
    with pytest.raises(LogError, match=r"needs force_per_ampere in \[units\].*, or torque_constant in \[axis\]"):
        dd.read_log(columns, units={"command": "A"})


def test_without_a_sheet_a_motors_unit_is_part_of_a_name():
    """As it always was: a column of revolutions is no velocity of an axis of which no lead is known."""
    log = dd.read_log({"time": TIME, "position": POSITION, "command": COMMAND, "velocity_rpm": VELOCITY})
    assert log.velocity is None
