"""The table [axis]: read, written, used for the units of a file's numbers and for what effects would state again."""

import dataclasses
import math
import tomllib

import numpy as np
import pytest
import tomli_w

import diffdrive as dd
from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import axis_tables, parse_axis, read_axis
from diffdrive.errors import DriveFileError, LogError, ParameterError
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.model.data_sheet import DataSheet

SHEET = DataSheet(
    lead=10e-3, gear_ratio=2.0, motor_inertia=5e-5, rated_torque=5.0, rated_current=4.0, torque_constant=1.2,
    encoder_counts=10_000.0, scale_period=20e-6,
)  # fmt: skip
R = 10e-3 / (4.0 * math.pi)  # m per rad of the motor
STATED = {
    "lead": "10 mm", "gear_ratio": 2.0, "motor_inertia": "0.5 kg*cm^2", "rated_torque": "5 Nm", "rated_current": "4 A",
    "torque_constant": "1.2 N*m/A", "encoder_counts": 10_000, "scale_period": 20e-6,
}  # fmt: skip


def tables(**changes) -> dict:
    """Those of the paper's axis under a cascade, with changes by table; None takes a table away."""
    whole = axis_tables(dd.paper_axis(controller="cascade"))
    for name, keys in changes.items():
        whole[name] = whole.get(name, {}) | keys
    return whole


def test_the_table_is_read_in_any_unit():
    assert parse_axis(tables(axis=STATED)).sheet == SHEET
    assert parse_axis(tables(axis={})).sheet.is_empty
    turned = parse_axis(tables(axis={"kind": "rotary", "scale_period": "20 arcsec"})).sheet
    assert turned.scale_period == pytest.approx(math.radians(20 / 3600))
    assert dataclasses.replace(turned, scale_period=None) == DataSheet(kind="rotary")


@pytest.mark.parametrize("sheet", [SHEET, DataSheet(), DataSheet(lead=5e-3), DataSheet(kind="rotary", gear_ratio=90.0)])
def test_what_is_written_is_read_back(sheet, tmp_path):
    axis = dataclasses.replace(dd.paper_axis(), sheet=sheet)
    axis.write(tmp_path / "drive.toml")
    assert ("axis" in tomllib.loads((tmp_path / "drive.toml").read_text())) is not sheet.is_empty
    assert read_axis(tmp_path / "drive.toml").sheet == sheet


def test_numbers_of_the_file_are_in_the_shops_units():
    axis = parse_axis(
        tables(
            axis=STATED,
            plant={"mass": "2 kg*cm^2", "damping": ["1e-4 N*m*s/rad", "2e-4 N*m*s/rad"]},
            friction={"coulomb_screw": ["10 %", "0.6 A"], "stribeck_velocity": "5 min^-1"},
            actuator={"force_limit": "120 %"},
            sensor={"resolution": "1 count", "noise": "0.001 deg"},
            limits={"stroke": ["0 rev", "20 rev"], "speed": "3000 rpm"},
            controller={"kv": "3 N*m*s/rad", "ki": "40 N*m/rad"},
        )
    )
    expected = {
        "plant.mass": 2e-4 / R**2,
        "plant.damping": (1e-4 / R**2, 2e-4 / R**2),
        "friction.coulomb_screw": (0.5 / R, 0.72 / R),
        "friction.stribeck_velocity": (5e-3 / 12.0, 5e-3 / 12.0),
        "actuator.force_limit": 6.0 / R,
        "sensor.resolution": 5e-7,
        "sensor.noise": math.radians(1e-3) * R,
    }
    for path, value in expected.items():
        assert axis.value(path) == pytest.approx(value, rel=1e-13)
    assert axis.limits.stroke == pytest.approx((0.0, 0.1))
    assert axis.limits.speed == pytest.approx(0.25)
    assert float(axis.gains["kv"]) == pytest.approx(3.0 / R**2)
    written = tomli_w.dumps(axis_tables(axis))
    assert not any(unit in written for unit in ("%", "rev", "rpm", "N*m", "deg"))
    assert axis_tables(parse_axis(tomllib.loads(written))) == axis_tables(axis)


def rotary(**changes) -> dict:
    """The same axis with its numbers as those of a table that turns: rad for m, N m for N, kg m^2 for kg."""
    return tables(axis={"kind": "rotary", "gear_ratio": 90.0, "rated_torque": "5 N*m"}, **changes)


def test_a_rotary_axis_moves_as_its_linear_twin():
    turned = parse_axis(
        rotary(
            plant={"mass": "100 kg*m^2", "damping": "320 N*m*s/rad"},
            friction={"bristle_stiffness": "33.5 N*m/urad", "stribeck_velocity": "1 mrad/s"},
            actuator={"force_limit": "444.4444444444444 %"},
            sensor={"resolution": "1e-7 rad"},
            limits={"stroke": ["-75 mrad", "75 mrad"]},
        )
    )
    plain = parse_axis(
        tables(
            plant={"mass": "100 kg", "damping": 320.0},
            friction={"bristle_stiffness": 3.35e7, "stribeck_velocity": "1 mm/s"},
            actuator={"force_limit": 2000.0},
        )
    )
    assert turned.value("actuator.force_limit") == pytest.approx(2000.0)
    runs = [
        dd.simulate(axis, dd.motion.sine(amplitude=1e-3, frequency=5.0, duration=0.2, rate=axis.rate), 100.0)
        for axis in (turned.replace({"actuator.force_limit": 2000.0}), plain)
    ]
    np.testing.assert_allclose(runs[0].table_position, runs[1].table_position, rtol=0.0, atol=1e-12)


WRONG = {
    "share without a torque": (
        tables(actuator={"force_limit": "80 %"}),
        r"\[actuator\] force_limit: \[axis\] rated_torque and lead are needed to read '80 %'",
    ),
    "gain without a lead": (
        tables(controller={"kv": "3 N*m*s/rad"}),
        r"\[controller\] kv: \[axis\] lead is needed",
    ),
    "kind": (tables(axis={"kind": "round"}), r"\[axis\] kind: must be one of linear, rotary, got 'round'"),
    "key": (tables(axis={"pitch": 0.01}), r"\[axis\] pitch: unknown key"),
    "near key": (tables(axis={"gear_rato": 2.0}), r"\[axis\] gear_rato: unknown key; did you mean 'gear_ratio'"),
    "unit": (tables(axis={"rated_torque": "5 N"}), r"\[axis\] rated_torque: '5 N' has the wrong unit: .* N\*m"),
    "range": (tables(axis={"lead": 0.0}), r"axis\.lead must be above 0"),
    "lead of a rotary axis": (tables(axis={"lead": "10 mm", "kind": "rotary"}), r"axis\.lead: a rotary axis has none"),
    "length on a rotary axis": (rotary(sensor={"resolution": "1 um"}), r"\[sensor\] resolution: .* in rad or"),
    "mass on a rotary axis": (rotary(plant={"mass": "5 kg"}), r"\[plant\] mass: .* in kg\*m\^2 or"),
    "no number on a rotary axis": (rotary(plant={"mass": True}), r'must be a number in kg\*m\^2, or .*"1.5 kg\*m\^2"'),
    "rotor heavier than all": (
        tables(axis={"lead": "10 um", "motor_inertia": 1e-4}),
        r"\[plant\] mass: is 100 kg, less than the motor's rotor alone: \[axis\] motor_inertia makes 3\.948e\+07;",
    ),
    "two leads": (
        tables(axis={"lead": "10 mm"}, effects={"lead_error": {"lead": "5 mm", "sine": "1 um"}}),
        r"effects\.lead_error\.lead is 0\.005, and \[axis\] lead 0\.01: they are one and the same",
    ),
    "two periods": (
        tables(axis={"scale_period": "20 um"}, effects={"interpolation_error": {"period": "40 um"}}),
        r"effects\.interpolation_error\.period is 4e-05, and \[axis\] scale_period 2e-05",
    ),
}  # fmt: skip


@pytest.mark.parametrize(("content", "says"), WRONG.values(), ids=WRONG.keys())
def test_a_file_that_says_too_little_or_two_things_is_refused(content, says):
    with pytest.raises(DriveFileError, match=f"^axis.toml: .*{says}"):
        parse_axis(content, "axis.toml")


def test_effects_take_from_the_sheet_what_they_leave_out():
    named = {"lead_error": {"sine": "1 um"}, "interpolation_error": {"sine": "10 nm"}}
    axis = parse_axis(tables(axis=STATED, effects=named))
    assert axis.value("effects.lead_error.lead") == 10e-3
    assert axis.value("effects.interpolation_error.period") == SHEET.scale_period
    written = axis_tables(axis)
    assert "lead" not in written["effects"]["lead_error"]
    assert "period" not in written["effects"]["interpolation_error"]
    assert parse_axis(written).parameters == axis.parameters
    both = parse_axis(tables(axis=STATED, effects={"lead_error": {"lead": "1 cm", "sine": "1 um"}}))
    assert both.value("effects.lead_error.lead") == pytest.approx(10e-3)
    alone = parse_axis(tables(effects=named))
    assert alone.value("effects.lead_error.lead") == 5e-3


def test_an_effect_given_in_a_program_agrees_with_the_sheet():
    axis = dataclasses.replace(dd.paper_axis(), sheet=SHEET)
    assert axis.with_effects(dd.effects.LeadError(lead=10e-3, sine=1e-6)).value("effects.lead_error.lead") == 10e-3
    with pytest.raises(ParameterError, match=r"effects\.lead_error\.lead is 0\.005, and \[axis\] lead 0\.01"):
        axis.with_effects(dd.effects.LeadError(sine=1e-6))


def test_a_lead_that_was_found_or_varied_outweighs_the_sheet_in_what_is_written():
    """A sweep of the lead and a diagnosis write machines that a file must be able to hold."""
    axis = dataclasses.replace(dd.paper_axis(), sheet=SHEET, mapping=ColumnMapping(units={"command": "%"}, sheet=SHEET))
    axis = axis.with_effects(dd.effects.LeadError(lead=10e-3, sine=1e-6)).replace({"effects.lead_error.lead": 9.9e-3})
    again = parse_axis(axis_tables(axis))
    assert again.value("effects.lead_error.lead") == 9.9e-3
    assert again.sheet == dataclasses.replace(SHEET, lead=None)
    assert float(again.mapping.units["command"].removesuffix(" N")) == pytest.approx(0.05 / R)


def test_a_file_states_the_units_of_its_logs_by_the_sheet():
    stated = {"command": "-%", "position": "deg", "velocity": "min^-1", "current": "%", "reference": "mm"}
    axis = parse_axis(tables(axis=STATED, units=stated))
    assert axis.mapping.units == stated
    again = parse_axis(axis_tables(axis))
    assert again.mapping.units["reference"] == "mm"
    for channel, unit in stated.items():
        value = axis.mapping.conversion(channel, unit, "here")
        assert again.mapping.conversion(channel, again.mapping.units[channel], "here") == value
    with pytest.raises(DriveFileError, match=r"\[units\] command: '%' is no unit of the command without \[axis\] rat"):
        parse_axis(tables(units={"command": "%"}))
    with pytest.raises(LogError, match=r"'mm' is no unit of the position: write one that converts to rad"):
        ColumnMapping(units={"position": "mm"}, sheet=DataSheet(kind="rotary"))


def test_an_axis_with_a_sheet_passes_through_jit():
    import jax

    axis = dataclasses.replace(dd.paper_axis(), sheet=SHEET)
    doubled = jax.jit(lambda one: one.replace({"plant.mass": 2.0 * one.value("plant.mass")}))(axis)
    assert isinstance(doubled, Axis)
    assert doubled.sheet == SHEET
    assert hash(axis.mapping) == hash(ColumnMapping(force_per_volt=axis.mapping.force_per_volt))
