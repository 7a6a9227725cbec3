"""Motions, loads and numbers of options in units of the motor, by the axis's data sheet."""

import numpy as np
import pytest

from diffdrive.errors import MotionError
from diffdrive.model.data_sheet import DataSheet
from diffdrive.motion.text import nonnegative_number, numbers, parse_load, parse_motion

SHEET = DataSheet(lead=10e-3, rated_torque=5.0, encoder_counts=10_000.0)
FORCE = 2.0 * np.pi / 10e-3  # N per N m
RATE = 1000.0


def test_a_motion_is_stated_in_turns():
    turns = parse_motion("triangular:speed=60rpm,stroke=2rev,rounding=0.3s,duration=4.5s", RATE, SHEET)
    metres = parse_motion("triangular:speed=10mm/s,stroke=20mm,rounding=0.3s,duration=4.5s", RATE)
    np.testing.assert_allclose(turns.position, metres.position, rtol=0.0, atol=1e-15)


def test_a_motion_of_a_file_has_units_in_its_header(tmp_path):
    time = np.arange(200) / RATE
    path = tmp_path / "own.csv"
    rows = np.column_stack([time, 360.0 * np.sin(time)])
    np.savetxt(path, rows, delimiter=",", header="time [s],position [deg]", comments="", fmt="%.17g")
    np.testing.assert_allclose(parse_motion(str(path), RATE, SHEET).position, 10e-3 * np.sin(time), atol=1e-12)


def test_forces_are_shares_of_the_rated_torque():
    assert nonnegative_number("80 %", "N", "--max-load", SHEET) == pytest.approx(4.0 * FORCE)
    assert numbers("5;10;20 %", "N", "--pareto", SHEET) == pytest.approx([0.25 * FORCE, 0.5 * FORCE, FORCE])
    np.testing.assert_allclose(parse_load("step:at=1s,to=2N*m", np.array([0.0, 2.0]), SHEET), [0.0, 2.0 * FORCE])


def test_what_the_sheet_does_not_say_is_named():
    with pytest.raises(MotionError, match=r"^triangular: speed: \[axis\] lead is needed to read '60rpm'$"):
        parse_motion("triangular:speed=60rpm,stroke=2rev,rounding=0.3s,duration=4.5s", RATE)
