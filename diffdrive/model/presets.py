"""Drives that the project knows: the paper's testbed."""

import math

from diffdrive.model.parameters import Actuator, Drive, Friction, Plant, Sensor
from diffdrive.model.quantity import Directional

PAPER_FORCE_PER_VOLT = 0.1 * 1.27 * 2 * math.pi / 0.005  # N/V, eq. (3): 159.593
PAPER_KP = 50_000 * PAPER_FORCE_PER_VOLT  # N/m; the paper gives 50,000 command volts per metre
PAPER_KD = 100 * PAPER_FORCE_PER_VOLT  # N s/m; the paper gives 100 command volts per metre per second
PAPER_RESOLUTION = 1e-7  # m
PAPER_STROKE = 0.150  # m


def paper_drive(*, quantised: bool = True) -> Drive:
    """The testbed of Lee et al. 2015, Tables 2 and 3; `quantised=False` leaves out the scale's 0.1 um resolution."""
    return Drive(
        plant=Plant(mass=100.0, damping=Directional(380.0, 260.0)),
        friction=Friction(
            coulomb_screw=Directional(63.43, 64.95),
            load_coefficient=Directional(3.66e-4, 3.66e-4),
            initial_load=15_200.0,
            breakaway_gap=Directional(30.0, 22.98),
            stribeck_velocity=Directional(0.0010, 0.0014),
            viscous=Directional(1826.5, 1673.5),
            bristle_stiffness=Directional(3.35e7, 3.35e7),
            bristle_damping=Directional(4.54e3, 4.54e3),
        ),
        actuator=Actuator(),
        sensor=Sensor(resolution=PAPER_RESOLUTION if quantised else None),
    )
