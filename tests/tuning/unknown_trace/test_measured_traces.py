"""Traces of a measured axis and of machines that are not of this package's making, under headers that say little."""

import json

import numpy as np
import pytest

import tuning
from diffdrive.logs.checks.dynamics import ACCURACY
from diffdrive.logs.read import read_table
from experiments.studies.data_folder import find_data
from experiments.studies.emps.axis import find_folder

EMPS = find_folder()
FOREIGN = find_data("bench-foreign", "key.json")
LEAD, RATED = 0.01, 5.0  # m, N m


@pytest.mark.skipif(EMPS is None, reason="needs the EMPS data in ../shared/data/emps")
def test_emps_is_read_once_its_volts_are_stated():
    """t, qg, qm, vir: published are 95.1 kg, 20.4 N, 203.5 N s/m, +3.2 N, and steps of 50 nm."""
    path = EMPS / "DATA_EMPS.mat"
    unstated = tuning.start(path, mass=95.0)
    assert {(one.argument, one.channel) for one in unstated.questions} == {("units", "position"), ("units", "command")}
    result = tuning.start(path, mass=95.0, units={"command": "V", "force_per_volt": "35.15065"})
    assert result.status.ok
    columns = result.axis.mapping.columns
    assert columns == {"time": "t", "reference": "qg", "position": "qm", "command": "vir"}
    assert result.axis.mapping.units["position"] == "m"
    assert result.implied_mass == pytest.approx(95.1, rel=ACCURACY)
    assert float(result.axis.drive.friction.coulomb_screw.positive) == pytest.approx(20.39, rel=ACCURACY)
    assert float(result.axis.drive.friction.viscous.positive) == pytest.approx(203.5, rel=ACCURACY)
    assert float(result.axis.drive.plant.constant_force) == pytest.approx(3.16, rel=0.2)
    assert float(result.axis.drive.sensor.resolution) == pytest.approx(5e-8, rel=1e-3)


@pytest.mark.long
@pytest.mark.skipif(FOREIGN is None, reason="needs the machines in ../shared/data/bench-foreign")
@pytest.mark.parametrize("case", ["02", "06", "10", "13"])
def test_the_friction_of_a_foreign_machine_is_seen(case):
    """A CNC, the slow trace of one, a linear motor and a gantry of two encoders; commands reversed, in per cent."""
    truth = json.loads((FOREIGN / "key.json").read_text())[case]["healthy"]
    table = read_table(FOREIGN / case / "healthy-1.parquet").columns
    columns = {
        "Zeit [ms]": 1e3 * table["time"],
        "Lagesollwert [mm]": 1e3 * table["reference"],
        "Lageistwert [mm]": 1e3 * table["position"],
        "Momentensollwert [%]": -100.0 * table["command"] * LEAD / (2 * np.pi) / RATED,
    }
    if "motor_position" in table:
        columns["Motorgeber [deg]"] = 360.0 * table["motor_position"] / LEAD
    result = tuning.start(columns, mass=1.2 * truth["mass"], lead=LEAD, rated_torque=RATED)
    assert result.status.ok
    assert result.axis.mapping.columns["position"] == "Lageistwert [mm]"
    assert result.axis.mapping.units["command"] == "-%"
    guides = truth["load_coefficient"] * truth["initial_load"]
    coulomb = guides + 0.5 * (truth["coulomb_screw+"] + truth["coulomb_screw-"])
    viscous = 0.5 * (truth["viscous+"] + truth["viscous-"])
    assert float(result.axis.drive.friction.coulomb_screw.positive) == pytest.approx(coulomb, rel=ACCURACY)
    assert float(result.axis.drive.friction.viscous.positive) == pytest.approx(viscous, rel=ACCURACY)
