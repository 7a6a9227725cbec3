"""The EMPS benchmark (Janot et al. 2019), a real axis: its files as logs, its controller, its published parameters."""

import dataclasses
from pathlib import Path
from typing import NamedTuple

import scipy.io

from diffdrive.axis import Axis
from diffdrive.controllers import Cascade
from diffdrive.logs import ColumnMapping, Log, read_log
from diffdrive.model.parameters import Actuator, Drive, Friction, Plant, Sampling, Sensor
from diffdrive.model.quantity import Directional
from diffdrive.motion.motion import Limits
from experiments.studies.data_folder import find_data

FILES = {"estimation": "DATA_EMPS.mat", "pulses": "DATA_EMPS_PULSES.mat"}
COLUMNS = {"time": "t", "reference": "qg", "position": "qm", "command": "vir"}
PULSE_GAIN = 1.0139  # V per unit of pulses_N, see docs/evidence/emps.md
COUNT = 5e-8  # m, of the motor's encoder through the screw
LEAD = 2.5e-3  # m per turn of the motor
SAMPLING = Sampling(rate=1_000.0, substeps=40)


class Record(NamedTuple):
    """One EMPS file: its log, with the pulses as the disturbance, and the gains that it states."""

    log: Log
    position_gain: float  # 1/s
    velocity_gain: float  # N s/m


def find_folder() -> Path | None:
    """The EMPS data beside this checkout or the working folder, or None."""
    return find_data("emps", FILES["estimation"])


def read(path: Path, *, newtons: bool = True) -> Record:
    """Read one file; its `vir` and `pulses_N` are volts, whatever their names say.

    The command of the log is the controller's own, without the pulses that were added to it. Without `newtons` the file
    is taken literally instead: volts as newtons, and the command with the pulses.
    """
    data = scipy.io.loadmat(path, variable_names=["kp", "kv", "gtau", "pulses_N"])
    force_per_volt = float(data["gtau"].item())
    columns, units = dict(COLUMNS), {"command": "V" if newtons else "N"}
    if "pulses_N" in data:
        pulses = "injected" if newtons else "disturbance"
        columns[pulses] = "pulses_N"
        units[pulses] = f"{PULSE_GAIN} V" if newtons else "N"
    log = read_log(path, mapping=ColumnMapping(columns, units, force_per_volt), rate=SAMPLING.rate)
    return Record(log, float(data["kp"].item()), float(data["kv"].item()) * force_per_volt)


def read_all(folder: Path) -> dict[str, Record]:
    """The files that are in the folder, by the names of `FILES`."""
    return {name: read(folder / file) for name, file in FILES.items() if (folder / file).is_file()}


def reference_drive() -> Drive:
    """The benchmark's own parameters (inverse-dynamics least squares), with a stiff bristle under them."""
    return Drive(
        plant=Plant(mass=95.1089, damping=Directional(0.0, 0.0), constant_force=3.1648),
        friction=Friction(
            coulomb_screw=Directional(20.3935, 20.3935),
            load_coefficient=Directional(0.0, 0.0),
            initial_load=0.0,
            breakaway_gap=Directional(1e-3, 1e-3),
            stribeck_velocity=Directional(1e-3, 1e-3),
            viscous=Directional(203.5034, 203.5034),
            bristle_stiffness=Directional(1e6, 1e6),
            bristle_damping=Directional(3e3, 3e3),
        ),
    )


def controller(record: Record) -> Cascade:
    """The benchmark's controller: kp kv e - kv dq/dt, dq/dt the backward difference of the two-sample mean."""
    return Cascade(kp=record.position_gain, kv=record.velocity_gain, velocity_samples=2)


def nominal_axis(record: Record, *, delay_samples: int = 0) -> Axis:
    """The axis as a drive file would state it, with `delay_samples` of the actuator."""
    drive = dataclasses.replace(
        reference_drive(), actuator=Actuator(delay_samples=delay_samples), sensor=Sensor(resolution=COUNT)
    )
    return Axis(drive, controller(record), SAMPLING, Limits())
