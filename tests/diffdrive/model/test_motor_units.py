"""The motor's units at the table, by the data sheet: exact conversions, and what the sheet must say for each."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive.errors import ParameterError
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.motor_units import MissingKeysError, axis_unit, to_axis_si
from diffdrive.support.units import WrongUnitError

SCREW = DataSheet(lead=10e-3, gear_ratio=2.0, rated_torque=5.0, rated_current=4.0, encoder_counts=10_000.0)
TABLE = DataSheet(kind="rotary", gear_ratio=90.0, rated_torque=5.0, rated_current=4.0, encoder_counts=10_000.0)
R = 10e-3 / (2.0 * math.pi) / 2.0  # m per rad of the motor

ON_A_SCREW = {
    # every kind of quantity that a drive file has, in the motor's unit and what it is at the table
    "torque": ("1.2 N*m", "N", 1.2 / R),
    "torque without a sign": ("1.2 Nm", "N", 1.2 / R),
    "share": ("120 %", "N", 6.0 / R),
    "current": ("-3 A", "N", -3.0 * 1.25 / R),
    "inertia": ("2 kg*cm^2", "kg", 2e-4 / R**2),
    "angle": ("0.001 deg", "m", math.radians(0.001) * R),
    "revolution": ("2 rev", "m", 10e-3),
    "count": ("1 count", "m", 2.0 * math.pi / 10_000 * R),
    "speed": ("3000 rpm", "m/s", 0.25),
    "acceleration": ("50 rev/s^2", "m/s^2", 0.25),
    "damping": ("3 N*m*s/rad", "N*s/m", 3.0 / R**2),
    "damping in amperes": ("3 A*s/rad", "N*s/m", 3.75 / R**2),
    "damping at the table": ("3 A*s/m", "N*s/m", 3.75 / R),
    "stiffness": ("3 N*m/rad", "N/m", 3.0 / R**2),
    "share per count": ("1 %/count", "N/m", 0.05 / R / (2.0 * math.pi / 10_000 * R)),
    "variance": ("1 count^2", "m^2", (2.0 * math.pi / 10_000 * R) ** 2),
    "drag that grows": ("1 N*m*s^2/rad^2", "N*s^2/m^2", 1.0 / R**3),
    "per travel": ("0.5 1/rev", "1/m", 0.5 / 5e-3),
    # and what is the table's
    "force": ("1.2 kN", "N", 1200.0),
    "travel": ("5 mm", "m", 5e-3),
    "gain": ("33.5 N/um", "N/m", 33.5e6),
    "Kv": ("3 m/min/mm", "1/s", 50.0),
    "ratio": ("20 %", "1", 0.2),
    "current itself": ("80 %", "A", 3.2),
}  # fmt: skip


@pytest.mark.parametrize(("text", "unit", "value"), ON_A_SCREW.values(), ids=ON_A_SCREW.keys())
def test_units_of_the_motor_are_those_of_the_table(text, unit, value):
    text = text.replace("0.5 1/rev", "0.5 /rev")
    assert to_axis_si(text, unit, SCREW) == pytest.approx(value, rel=1e-14)


ON_A_TABLE = {
    "torque": ("1.2 N*m", "N", 1.2),
    "share": ("120 %", "N", 540.0),
    "current": ("3 A", "N", 3.75 * 90.0),
    "angle": ("0.001 deg", "m", math.radians(0.001)),
    "arc": ("3 arcsec", "m", math.radians(3 / 3600)),
    "count": ("1 count", "m", 2.0 * math.pi / 10_000 / 90.0),
    "speed": ("30 min^-1", "m/s", math.pi),
    "inertia": ("2 kg*m^2", "kg", 2.0),
    "damping": ("3 N*m*s/rad", "N*s/m", 3.0),
    "stiffness": ("3 N*m/deg", "N/m", 540.0 / math.pi),
}


@pytest.mark.parametrize(("text", "unit", "value"), ON_A_TABLE.values(), ids=ON_A_TABLE.keys())
def test_a_rotary_axis_has_its_own_torques_and_angles(text, unit, value):
    assert to_axis_si(text, unit, TABLE) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize(
    "text",
    ["3000 rpm", "3000rpm", "3000 min^-1", "3000 min-1", "3000 1/min", "3000/min", "3000 U/min", "3000 r/min",
     "50 rev/s", "3e3 rev/min"],
)  # fmt: skip
def test_turns_per_minute_as_data_sheets_write_them(text):
    assert to_axis_si(text, "m/s", SCREW) == pytest.approx(0.25, rel=1e-14)


positive = st.floats(1e-3, 1e3)


@settings(max_examples=50, deadline=None)
@given(lead=positive, gear=positive, torque=positive, current=positive, counts=positive, value=st.floats(-1e3, 1e3))
def test_power_and_energy_are_the_same_on_both_sides(lead, gear, torque, current, counts, value):
    """Torque times turning speed is force times travel speed; inertia and mass hold the same energy."""
    sheet = DataSheet(lead=lead, gear_ratio=gear, rated_torque=torque, rated_current=current, encoder_counts=counts)
    force, speed = to_axis_si(f"{value!r} N*m", "N", sheet), to_axis_si("70 rad/s", "m/s", sheet)
    assert force * speed == pytest.approx(70.0 * value, rel=1e-12)
    assert to_axis_si("3 kg*m^2", "kg", sheet) * speed**2 == pytest.approx(3.0 * 70.0**2, rel=1e-12)
    assert to_axis_si("2 N*m*s/rad", "N*s/m", sheet) * speed**2 == pytest.approx(2.0 * 70.0**2, rel=1e-12)
    assert to_axis_si("100 %", "N", sheet) == pytest.approx(to_axis_si(f"{current!r} A", "N", sheet), rel=1e-12)
    assert to_axis_si("100 %", "N", sheet) == pytest.approx(sheet.rated_force, rel=1e-12)
    assert to_axis_si(f"{counts!r} count", "m", sheet) * gear == pytest.approx(lead, rel=1e-12)


NEEDS = {
    "share": ("80 %", "N", r"^\[axis\] rated_torque and lead are needed to read '80 %'$"),
    "angle": ("5 deg", "m", r"^\[axis\] lead is needed to read '5 deg'$"),
    "turns": ("3000 min^-1", "m/s", r"^\[axis\] lead is needed to read '3000 min\^-1'$"),
    "count": ("5 counts", "m", r"^\[axis\] encoder_counts and lead are needed"),
    "current": ("5 A", "N", r"^\[axis\] torque_constant and lead are needed"),
    "share of the current": ("5 %", "A", r"^\[axis\] rated_current is needed"),
}


@pytest.mark.parametrize(("text", "unit", "says"), NEEDS.values(), ids=NEEDS.keys())
def test_what_the_sheet_does_not_say_is_named(text, unit, says):
    with pytest.raises(MissingKeysError, match=says):
        to_axis_si(text, unit, NO_SHEET)


WRONG = {
    "mass for a force": ("5 kg", "N", SCREW, "must be in N or"),
    "plain number for an angle": ("0.8", "m", SCREW, "must be in m or"),
    "plain number for a share": ("0.8", "N", SCREW, "must be in N or"),
    "torque for a stiffness": ("5 N*m", "N/m", SCREW, "must be in N/m or"),
    "torque per travel": ("5 N*m/m", "N/m", SCREW, "must be in N/m or"),
    "frequency for a speed": ("50 Hz", "m/s", SCREW, "must be in m/s or"),
    "angle for a frequency": ("50 rad/s", "Hz", SCREW, "must be in Hz or"),
    "length on a rotary axis": ("5 mm", "m", TABLE, "must be in rad or"),
    "force on a rotary axis": ("5 N", "N", TABLE, r"must be in N\*m or"),
    "mass on a rotary axis": ("5 kg", "kg", TABLE, r"must be in kg\*m\^2 or"),
    "damping on a rotary axis": ("5 N*s/m", "N*s/m", TABLE, r"must be in N\*m\*s/rad or"),
}


@pytest.mark.parametrize(("text", "unit", "sheet", "says"), WRONG.values(), ids=WRONG.keys())
def test_a_unit_of_something_else_is_refused_in_terms_of_the_axis(text, unit, sheet, says):
    with pytest.raises(WrongUnitError, match=says):
        to_axis_si(text, unit, sheet)


def test_parameters_of_a_rotary_axis_have_its_units():
    units = ("N", "m", "kg", "N*s/m", "m^2", "N*s^2/m^2", "1/m", "1/s", "Hz", "1", "A")
    rotary = ("N*m", "rad", "kg*m^2", "N*m*s/rad", "rad^2", "N*m*s^2/rad^2", "1/rad", "1/s", "Hz", "1", "A")
    assert [axis_unit(unit, SCREW) for unit in units] == list(units)
    assert [axis_unit(unit, TABLE) for unit in units] == list(rotary)


def test_a_sheet_says_what_follows_from_it():
    assert SCREW.rated_force == pytest.approx(5.0 / R)
    assert SCREW.torque_per_ampere == 1.25
    assert DataSheet(rated_torque=5.0, rated_current=4.0, torque_constant=1.1).torque_per_ampere == 1.1
    assert DataSheet(lead=10e-3, motor_inertia=1e-4).rotor_mass == pytest.approx(1e-4 * (2.0 * math.pi / 10e-3) ** 2)
    assert TABLE.travel_per_radian == 1.0 / 90.0
    assert NO_SHEET.is_empty
    assert not SCREW.is_empty
    for name in ("travel_per_radian", "rated_force", "rotor_mass", "torque_per_ampere"):
        assert getattr(NO_SHEET, name) is None
    assert {SCREW: 1}[DataSheet(lead=10e-3, gear_ratio=2.0, rated_torque=5.0, rated_current=4.0, encoder_counts=1e4)]
    assert SCREW != TABLE


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"kind": "spherical"}, "axis.kind: must be one of linear, rotary, got 'spherical'"),
        ({"lead": 0.0}, "axis.lead must be above 0 m"),
        ({"kind": "rotary", "lead": 0.01}, "axis.lead: a rotary axis has none"),
        ({"gear_ratio": -3.0}, "axis.gear_ratio must be above 0"),
    ],
)
def test_a_sheet_of_no_axis_is_refused(values, says):
    with pytest.raises(ParameterError, match=says):
        DataSheet(**values)
