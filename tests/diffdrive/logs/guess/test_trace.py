"""Columns, units and signs of a trace that nobody described: a simulated axis under headers of other makers."""

import numpy as np
import pytest

from diffdrive.errors import LogError
from diffdrive.logs.formats.table import Table
from diffdrive.logs.guess.trace import guess_trace
from diffdrive.model.data_sheet import DataSheet
from tests.support.cnc_axis import CncAxis, log_of
from tests.support.sound_log import SOUND

TIME, REFERENCE, POSITION, COMMAND = SOUND.time, SOUND.reference, SOUND.position, SOUND.command
SPEED = np.gradient(POSITION, TIME)
LEAD = 0.01  # m
TORQUE = COMMAND * LEAD / (2 * np.pi)  # N m
MASS = 100.0  # kg, of the axis; stated 10 % off below
RATED, CONSTANT = 5.0, 1.2  # N m, N m/A
SHEET = DataSheet(lead=LEAD, rated_torque=RATED, torque_constant=CONSTANT)

SIEMENS = {
    "Zeit [ms]": 1e3 * TIME,
    "Lagesollwert [mm]": 1e3 * REFERENCE,
    "Lageistwert [mm]": 1e3 * POSITION,
    "Momentensollwert [Nm]": TORQUE,
    "Drehzahlistwert [1/min]": 60.0 * SPEED / LEAD,
    "Schleppabstand [mm]": 1e3 * (REFERENCE - POSITION),
}
HEIDENHAIN = {
    "Time [s]": TIME,
    "s nominal X [mm]": 1e3 * REFERENCE,
    "s actual X [mm]": 1e3 * POSITION,
    "I nominal X [A]": TORQUE / CONSTANT,
    "v actual X [mm/min]": 6e4 * SPEED,
}
TWINCAT = {
    "Time [ms]": 1e3 * TIME,
    "Axis 1.SetPos": 1e3 * REFERENCE,
    "Axis 1.ActPos [mm]": 1e3 * POSITION,
    "Axis 1.ActVelo": 1e3 * SPEED,
    "Axis 1.ActTorque (‰)": 1e3 * TORQUE / RATED,
    "Axis 1.PosDiff": 1e3 * (REFERENCE - POSITION),
}


def table(columns):
    return Table("trace.csv", dict(columns))


def asked(found):
    return [(one.argument, one.channel) for one in found.questions]


HABITS = {
    "Siemens": (
        SIEMENS,
        DataSheet(),
        {"reference": "Lagesollwert [mm]", "position": "Lageistwert [mm]", "command": "Momentensollwert [Nm]"},
        {"time": "ms", "position": "mm", "reference": "mm", "command": "Nm", "velocity": "rpm"},
    ),
    "HEIDENHAIN": (
        HEIDENHAIN,
        SHEET,
        {"reference": "s nominal X [mm]", "position": "s actual X [mm]", "command": "I nominal X [A]"},
        {"time": "s", "position": "mm", "reference": "mm", "command": "A", "velocity": "mm/min"},
    ),
    "TwinCAT": (
        TWINCAT,
        SHEET,
        {"reference": "Axis 1.SetPos", "position": "Axis 1.ActPos [mm]", "command": "Axis 1.ActTorque (‰)"},
        {"time": "ms", "position": "mm", "reference": "mm", "command": "0.1 %", "velocity": "mm/s"},
    ),
}


@pytest.mark.parametrize(("columns", "sheet", "channels", "units"), HABITS.values(), ids=HABITS.keys())
def test_three_habits_of_naming_are_read(columns, sheet, channels, units):
    found = guess_trace(table(columns), sheet=sheet, mass=0.9 * MASS)
    assert found.questions == []
    assert {name: found.columns[name] for name in channels} == channels
    assert found.units == units
    assert found.rate == pytest.approx(SOUND.rate)
    assert found.implied_mass == pytest.approx(MASS, rel=0.02)
    assert not any("Schlepp" in column or "PosDiff" in column for column in found.columns.values())


def test_the_lead_follows_from_a_speed_in_turns_and_a_position_in_lengths():
    found = guess_trace(table(SIEMENS), mass=MASS)
    assert found.sheet.lead == pytest.approx(LEAD, rel=2e-3)


def test_a_stated_lead_that_the_trace_contradicts_is_asked_about():
    found = guess_trace(table(SIEMENS), mass=MASS, sheet=DataSheet(lead=2 * LEAD))
    assert asked(found) == [("gear_ratio", "")]
    assert found.questions[0].example == "2"
    found = guess_trace(table(SIEMENS), mass=MASS, sheet=DataSheet(lead=2 * LEAD, gear_ratio=2.0))
    assert found.questions == []


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_sign_of_the_command_is_that_of_friction_and_inertia(sign):
    columns = SIEMENS | {"Momentensollwert [Nm]": sign * TORQUE}
    assert guess_trace(table(columns), mass=MASS).units["command"] == ("Nm" if sign > 0 else "-Nm")


def test_a_reversed_reference_keeps_its_sign_beside_the_position():
    found = guess_trace(table(SIEMENS | {"Lagesollwert [mm]": -1e3 * REFERENCE}), mass=MASS)
    assert found.units["reference"] == "-mm"


def test_names_that_say_nothing_are_told_apart_by_the_numbers():
    """The command moves against the noise of the position, and the reference is ahead of it."""
    ahead = np.interp(TIME + 2e-3, TIME, REFERENCE)
    found = guess_trace(table({"a": TIME, "b": ahead, "c": POSITION, "d": COMMAND}), mass=MASS)
    assert found.questions == []
    assert found.columns == {"time": "a", "reference": "b", "position": "c", "command": "d"}
    assert found.units == {"time": "s", "reference": "m", "position": "m", "command": "N"}
    assert {guess.certainty for guess in found.guesses if guess.what in ("reference", "command")} == {"likely"}


def test_a_set_point_that_looks_measured_is_not_taken_at_its_name():
    found = guess_trace(
        table({"time [s]": TIME, "SetPos [m]": POSITION, "ActPos [m]": REFERENCE, "Torque [Nm]": TORQUE})
    )
    assert asked(found) == [("columns", "position")]
    assert "'SetPos [m]' is called a set-point" in found.questions[0].why
    assert "'ActPos [m]'" in found.questions[0].why


def test_units_that_nobody_states_are_asked_with_their_readings():
    """1 turn and 1 % make the mass that 1 mm and 0.1 % make, at this lead: nothing in the trace decides."""
    columns = {"t [s]": TIME, "SetPos": 1e3 * REFERENCE, "ActPos": 1e3 * POSITION, "Trq": 1e3 * TORQUE / RATED}
    found = guess_trace(table(columns), sheet=SHEET, mass=MASS)
    assert asked(found) == [("units", "position"), ("units", "command")]
    assert "rev and % make 100 kg" in found.questions[0].why
    assert "mm and 0.1 % make 100 kg" in found.questions[0].why
    decided = guess_trace(table(columns), sheet=SHEET, mass=MASS, units={"position": "mm"})
    assert decided.questions == []
    assert decided.units["command"] == "0.1 %"


def test_a_mass_that_no_unit_makes_is_no_reason_to_believe_one():
    found = guess_trace(table({"t": TIME, "SetPos": REFERENCE, "ActPos": POSITION, "Trq": 7.0 * COMMAND}), mass=MASS)
    assert asked(found) == [("units", "position"), ("units", "command")]
    assert "no unit that is known here fits" in found.questions[0].why


MISSING = {
    "lead": (SIEMENS.keys() - {"Drehzahlistwert [1/min]"}, SIEMENS, DataSheet()),
    "torque_constant": (HEIDENHAIN.keys(), HEIDENHAIN, DataSheet(lead=LEAD)),
    "rated_torque": (TWINCAT.keys(), TWINCAT, DataSheet(lead=LEAD)),
}


@pytest.mark.parametrize(("argument", "case"), MISSING.items(), ids=MISSING.keys())
def test_what_a_unit_takes_of_the_data_sheet_is_asked_by_name(argument, case):
    names, columns, sheet = case
    found = guess_trace(table({name: columns[name] for name in columns if name in names}), sheet=sheet, mass=MASS)
    assert (argument, "") in asked(found)


def test_a_command_whose_sign_no_motion_shows_is_asked():
    one_way = slice(0, int(0.7 * SOUND.rate))
    columns = {"time [s]": TIME, "ActPos [m]": POSITION, "Torque [Nm]": TORQUE}
    found = guess_trace(table({name: values[one_way] for name, values in columns.items()}), sheet=SHEET, mass=MASS)
    assert asked(found) == [("units", "command")]
    assert "sign" in found.questions[0].why
    stated = guess_trace(
        table({name: values[one_way] for name, values in columns.items()}),
        sheet=SHEET, mass=MASS, units={"command": "Nm"},
    )  # fmt: skip
    assert stated.questions == []


def test_a_clock_without_unit_has_the_one_that_makes_a_rate_of_a_control():
    for factor, unit in ((1.0, "s"), (1e3, "ms"), (1e9, "ns")):
        columns = {"time": factor * TIME, "position [m]": POSITION, "command [N]": COMMAND}
        assert guess_trace(table(columns), mass=MASS).units["time"] == unit
    either = guess_trace(table({"time": 1e6 * TIME, "position [m]": POSITION, "command [N]": COMMAND}), mass=MASS)
    assert asked(either) == [("units", "time")]
    assert "us (2000 Hz) or 100 ns (20000 Hz)" in either.questions[0].why
    counted = guess_trace(table({"1": np.arange(len(TIME)), "position": POSITION, "command": COMMAND}), mass=MASS)
    assert asked(counted) == [("units", "time")]
    clockless = guess_trace(table({"position": POSITION, "command": COMMAND}), mass=MASS)
    assert asked(clockless) == [("rate", "")]
    assert guess_trace(table({"position": POSITION, "command": COMMAND}), mass=MASS, rate=2e3).questions == []


@pytest.fixture(scope="module")
def two_encoders():
    """A CNC axis whose motor is ahead of the table by 200 um of backlash, at 2 ms."""
    return log_of(CncAxis(backlash=200e-6), seconds=8.0)


def test_an_angle_and_a_length_are_the_motors_and_the_scales(two_encoders):
    log = two_encoders
    columns = {
        "t [s]": log.time, "Pos cmd [mm]": 1e3 * log.reference, "Enc A [mm]": 1e3 * log.position,
        "Enc B [deg]": 360.0 * log.motor_position / LEAD, "Force [N]": log.command,
    }  # fmt: skip
    found = guess_trace(table(columns), mass=500.0)
    assert (found.columns["position"], found.columns["motor_position"]) == ("Enc A [mm]", "Enc B [deg]")
    assert found.units["motor_position"] == "deg"
    assert found.sheet.lead == pytest.approx(LEAD, rel=2e-3)


def test_of_two_lengths_the_one_that_is_ahead_is_the_motors(two_encoders):
    log = two_encoders
    columns = {
        "t [s]": log.time, "Pos cmd [mm]": 1e3 * log.reference, "Enc A [mm]": 1e3 * log.position,
        "Enc B [mm]": 1e3 * log.motor_position, "Force [N]": log.command,
    }  # fmt: skip
    found = guess_trace(table(columns), mass=500.0)
    assert (found.columns["position"], found.columns["motor_position"]) == ("Enc A [mm]", "Enc B [mm]")
    assert next(guess for guess in found.guesses if guess.what == "motor_position").certainty == "likely"


def test_two_encoders_that_differ_in_nothing_are_asked():
    log = log_of(CncAxis(wind_up=0.0), seconds=8.0)
    columns = {
        "t [s]": log.time, "Pos cmd [mm]": 1e3 * log.reference, "Enc A [mm]": 1e3 * log.position,
        "Enc B [mm]": 1e3 * log.motor_position, "Force [N]": log.command,
    }  # fmt: skip
    found = guess_trace(table(columns), mass=500.0)
    assert asked(found) == [("columns", "position")]
    assert "'Enc A [mm]', 'Enc B [mm]' are each a measured position" in found.questions[0].why
    decided = guess_trace(table(columns), mass=500.0, columns={"position": "Enc A [mm]"})
    assert decided.columns["motor_position"] == "Enc B [mm]"


def test_positions_of_two_axes_are_asked():
    columns = SIEMENS | {"Lageistwert Y [mm]": 30.0 * np.sin(7.0 * TIME)}
    found = guess_trace(table(columns), mass=MASS)
    assert asked(found) == [("columns", "position")]
    assert "do not move alike" in found.questions[0].why


def test_a_header_that_the_position_contradicts_is_left_out_of_what_nobody_needs():
    found = guess_trace(table(HEIDENHAIN | {"v actual X [mm/min]": 1e3 * SPEED}), sheet=SHEET, mass=MASS)
    assert "velocity" not in found.columns
    assert any("velocity: left out" in note for note in found.notes)


def test_a_rotary_axis_takes_an_angle_for_its_own():
    columns = {"t [s]": TIME, "Angle [deg]": np.rad2deg(10.0 * POSITION), "Torque [Nm]": 0.1 * COMMAND}
    found = guess_trace(table(columns), sheet=DataSheet(kind="rotary"), mass=1.0)
    assert found.questions == []
    assert found.implied_mass == pytest.approx(0.01 * MASS, rel=0.02)


def test_a_column_that_is_not_there_is_refused():
    with pytest.raises(LogError, match="no such column"):
        guess_trace(table(SIEMENS), columns={"position": "Istwert"})
    with pytest.raises(LogError, match="holds one value throughout"):
        guess_trace(table(SIEMENS | {"still": np.ones_like(TIME)}), columns={"position": "still"})


def test_a_column_that_has_the_name_of_a_channel_is_that_channel():
    """A simulated log has the true position of the table beside the measured one: that is no motor's encoder."""
    columns = {
        "time": TIME, "position": POSITION, "table_position": POSITION + 1e-8 * np.sin(TIME), "reference": REFERENCE,
        "command [N]": COMMAND,
    }  # fmt: skip
    found = guess_trace(table(columns), mass=MASS)
    assert found.questions == []
    assert (found.columns["position"], found.columns["reference"]) == ("position", "reference")
    assert "motor_position" not in found.columns
    exchanged = columns | {"position": REFERENCE, "reference": POSITION}
    assert asked(guess_trace(table(exchanged), mass=MASS)) == [("columns", "position")]


def test_lost_motion_is_no_lead(two_encoders):
    """Without a name, an encoder that is ahead by its sign alone is no set-point: it is asked about."""
    log = two_encoders
    columns = {"a": log.time, "b": log.command, "c": log.position, "d": log.motor_position}
    found = guess_trace(table(columns), mass=500.0)
    assert ("columns", "position") in asked(found)
    assert "reference" not in found.columns
