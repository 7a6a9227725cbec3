"""A motor with strong cogging (LAAS, anti-cogging on and off) as if it drove a screw, so that it reads as an axis.

A proportional velocity loop runs it at one turn a second; half of each log has the compensation. The command is the
measured current: it holds the compensation too, so that the motor's cogging is there in both halves.
"""

from pathlib import Path

import numpy as np

from diffdrive.logs import Log
from diffdrive.parameters import Drive, Friction, Plant, Sensor
from experiments.data_folder import beside

COMPENSATED = {"speed_test1.txt": 1, "speed_test.txt": 0}  # "Function Activated" while the compensation is on
LEAD = 5e-3  # m per turn, of the screw that it is thought to drive
METRES = LEAD / (2 * np.pi)  # per rad
NEWTONS = 0.025 / METRES  # per ampere, at a torque constant of 0.025 N m/A
RATE = 1e3  # Hz
STARTING = 0.5  # s, after the compensation is switched


def find_folder() -> Path | None:
    """The data beside this checkout or the working folder, or None."""
    folder = beside("laas_cogging", next(iter(COMPENSATED)))
    return folder if folder and all((folder / name).exists() for name in COMPENSATED) else None


def read(path: Path) -> dict[str, Log]:
    """The parts of one log without and with compensation ("off", "on"), on a uniform clock."""
    time, angle, _, _, current, active = np.loadtxt(path, delimiter=",", skiprows=1).T
    switched = int(np.flatnonzero(np.diff(active))[0]) + 1
    found = {}
    for part in (slice(0, switched), slice(switched, len(time))):
        clock = np.arange(time[part][0] + STARTING, time[part][-1], 1.0 / RATE)
        held = np.searchsorted(time[part], clock + 0.5 / RATE) - 1
        asked = current[part][held]
        position = METRES * np.interp(clock, time[part], angle[part])
        name = "on" if active[part.start] == COMPENSATED[path.name] else "off"
        found[name] = Log(f"{path.stem}, {name}", clock - clock[0], position, NEWTONS * asked)
    return found


def nominal_drive() -> Drive:
    """The motor's inertia and friction, by least squares over the logs with harmonics of the turn beside them."""
    inertia, coulomb, viscous = 2.7e-4, 0.05, 0.007  # A s^2/rad, A, A s/rad
    return Drive(
        plant=Plant(mass=inertia * NEWTONS / METRES, damping=0.0),
        friction=Friction(
            coulomb_screw=coulomb * NEWTONS,
            load_coefficient=0.0,
            initial_load=0.0,
            breakaway_gap=0.1 * coulomb * NEWTONS,
            stribeck_velocity=1e-3,
            viscous=viscous * NEWTONS / METRES,
            bristle_stiffness=coulomb * NEWTONS / 2e-6,
            bristle_damping=100.0,
        ),
        sensor=Sensor(resolution=3.1e-4 * METRES),
    )
