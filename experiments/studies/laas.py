"""A motor with strong cogging (LAAS, anti-cogging on and off) as if it drove a screw, so that it reads as an axis.

A proportional velocity loop runs it at one turn a second; half of each log has the compensation. The command is
the output of that loop. The compensation adds to it, and so is part of the machine, which hardly cogs with it.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy import signal

from diffdrive.logs import Log
from diffdrive.model.parameters import Drive, Friction, Plant, Sensor
from diffdrive.model.quantity import Directional
from experiments.studies.data_folder import find_data

ACTIVE_FLAGS = {"speed_test1.txt": 1, "speed_test.txt": 0}  # "Function Activated" while the compensation is on
LEAD = 5e-3  # m per turn, of the screw that it is thought to drive
METRES_PER_RAD = LEAD / (2 * np.pi)  # per rad
NEWTONS_PER_AMPERE = 0.025 / METRES_PER_RAD  # per ampere, at a torque constant of 0.025 N m/A
RATE = 1e3  # Hz
GAIN = 0.09  # A s/rad, of the velocity loop
CURRENT_DELAY = 2e-3  # s, by which the measured current follows what the loop asks for, where nothing is added to it
SETTLING_TIME = 0.5  # s, after the compensation is switched
RESOLUTION = 3.1e-4  # rad
BANDWIDTH = 150.0  # Hz, in which the motor is identified
COGGING_ORDERS = (12, 18, 24, 36, 72, 84, 144, 168, 216, 288)  # a turn: of the cogging beside which it is


def find_folder() -> Path | None:
    """The data beside this checkout or the working folder, or None."""
    folder = find_data("laas_cogging", next(iter(ACTIVE_FLAGS)))
    return folder if folder and all((folder / name).exists() for name in ACTIVE_FLAGS) else None


def read(path: Path) -> dict[str, Log]:
    """The parts of one log without and with compensation ("off", "on"), on a uniform clock."""
    time, angle, velocity, velocity_reference, _, active = np.loadtxt(path, delimiter=",", skiprows=1).T
    command = GAIN * (velocity_reference - velocity)
    switched = int(np.flatnonzero(np.diff(active))[0]) + 1
    logs = {}
    for part in (slice(0, switched), slice(switched, len(time))):
        clock = np.arange(time[part][0] + SETTLING_TIME, time[part][-1], 1.0 / RATE)
        # over a period, the mean of a current that runs from sample to sample
        current = np.interp(clock + 0.5 / RATE - CURRENT_DELAY, time[part], command[part])
        position = METRES_PER_RAD * np.interp(clock, time[part], angle[part])
        name = "on" if active[part.start] == ACTIVE_FLAGS[path.name] else "off"
        logs[name] = Log(f"{path.stem}, {name}", clock - clock[0], position, NEWTONS_PER_AMPERE * current)
    return logs


def nominal_drive(folder: Path) -> Drive:
    """The motor without its cogging: inertia and friction by least squares over the halves without compensation."""
    mass, coulomb, viscous = _least_squares([read(folder / name)["off"] for name in ACTIVE_FLAGS])
    return Drive(
        plant=Plant(mass=mass, damping=Directional(0.0, 0.0)),
        friction=Friction(
            coulomb_screw=Directional(coulomb, coulomb),
            load_coefficient=Directional(0.0, 0.0),
            initial_load=0.0,
            breakaway_gap=Directional(0.1 * coulomb, 0.1 * coulomb),
            stribeck_velocity=Directional(1e-3, 1e-3),
            viscous=Directional(viscous, viscous),
            bristle_stiffness=Directional(coulomb / 2e-6, coulomb / 2e-6),
            bristle_damping=Directional(100.0, 100.0),
        ),
        sensor=Sensor(resolution=RESOLUTION * METRES_PER_RAD),
    )


def _least_squares(logs: list[Log]) -> Float[np.ndarray, " 3"]:
    """Mass (kg), Coulomb friction (N) and viscous friction (N s/m) beside a cogging of each log."""
    lowpass = signal.butter(4, BANDWIDTH, fs=RATE, output="sos")
    columns, forces = [], []
    for number, log in enumerate(logs):
        velocity = np.gradient(log.position, 1.0 / RATE)
        turns = 2 * np.pi * np.outer(log.position / LEAD, COGGING_ORDERS)
        waves = np.zeros((len(log.time), 2 * len(logs) * len(COGGING_ORDERS)))
        waves[:, 2 * number * len(COGGING_ORDERS) : 2 * (number + 1) * len(COGGING_ORDERS)] = np.c_[
            np.cos(turns), np.sin(turns)
        ]
        smooth = signal.sosfiltfilt(lowpass, velocity)
        basis = np.c_[np.gradient(smooth, 1.0 / RATE), np.sign(smooth), velocity, waves]
        columns.append(signal.sosfiltfilt(lowpass, basis, axis=0))
        forces.append(signal.sosfiltfilt(lowpass, log.command))
    return np.linalg.lstsq(np.concatenate(columns), np.concatenate(forces), rcond=None)[0][:3]
