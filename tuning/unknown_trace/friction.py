"""A machine to start from: the stated mass, the friction that inverse dynamics shows, and usual values beside."""

from typing import NamedTuple

import numpy as np

from diffdrive.errors import DiffdriveError
from diffdrive.logs import Log
from diffdrive.logs.checks.dynamics import ACCURACY, SLIDING
from diffdrive.logs.checks.grid import fit_count_grid
from diffdrive.logs.checks.statistics import longest_piece, sampling_period, top_speed
from diffdrive.model.parameters import Actuator, Drive, Friction, Plant, Sensor, check_drive
from diffdrive.model.quantity import Directional
from tuning.identification import inverse_dynamics
from tuning.identification.inverse_dynamics import InverseDynamics
from tuning.identification.regressors import SYMMETRIC
from tuning.identification.seed import SIGNIFICANT, initial_drive

# What one log does not show as a rule, as machine tools have it: Armstrong-Helouvry, Dupont and Canudas de Wit 1994
# (breakaway some tens of per cent above Coulomb friction, Stribeck velocity of millimetres a second, presliding of
# micrometres), and a bristle as damped as theirs, sigma_1 = sqrt(sigma_0 m) (Canudas de Wit et al. 1995, for 1 kg).
LOAD_COEFFICIENT = 1e-3  # of rolling guides; beside no initial load it is of no effect, and a fit cannot begin at zero
BREAKAWAY_GAP = 0.25  # of the Coulomb friction
STRIBECK_VELOCITY = 5e-3  # m/s, or rad/s
PRESLIDING = 2e-6  # m, over which friction builds up
PRESLIDING_ANGLE = 2e-5  # rad: the same at a radius of 100 mm
SMALL = 0.01  # of the largest command: a Coulomb friction where the log shows none, so that a fit can look for it


class FirstMachine(NamedTuple):
    """The machine, what inverse dynamics found (None where it found nothing), and notes."""

    drive: Drive
    found: InverseDynamics | None
    notes: tuple[str, ...]


def first_machine(log: Log, mass: float, *, is_rotary: bool) -> FirstMachine:
    """A machine of this mass (kg) whose friction is that of a log's inverse dynamics."""
    sensor = Sensor(resolution=_resolution(log.position))
    encoder = None if log.motor_position is None else Sensor(resolution=_resolution(log.motor_position))
    small = SMALL * float(np.max(np.abs(log.command)))
    drive = _drive(mass, small, 0.0, 0.0, is_rotary=is_rotary, sensor=sensor, encoder=encoder)
    piece = longest_piece(log)
    slowest = SLIDING * top_speed(log.position[piece], sampling_period(log))
    try:
        found = inverse_dynamics.identify(log, SYMMETRIC, min_speed=slowest)
        seeded, notes = initial_drive(drive, found)
        check_drive(seeded)
    except DiffdriveError as problem:
        return FirstMachine(drive, None, (f"friction is a guess: inverse dynamics finds nothing ({problem})",))
    coulomb, viscous = (float(getattr(seeded.friction, name).positive) for name in ("coulomb_screw", "viscous"))
    constant = _constant_force(found, coulomb)
    kept = tuple(note for note in notes if note.startswith("friction."))
    return FirstMachine(
        _drive(mass, coulomb, viscous, constant, is_rotary=is_rotary, sensor=sensor, encoder=encoder), found, kept
    )


def _constant_force(found: InverseDynamics, coulomb: float) -> float:
    """A constant force where it is beyond its own error and what a balance of forces can be off; else none."""
    force, error = found.constant_force, found.standard_errors.get("constant_force", np.nan)
    if force is None or not abs(force) > max(SIGNIFICANT * error, ACCURACY * coulomb):
        return 0.0
    return _rounded(force)


def _drive(
    mass: float,
    coulomb: float,
    viscous: float,
    constant: float,
    *,
    is_rotary: bool,
    sensor: Sensor,
    encoder: Sensor | None,
) -> Drive:
    stiffness = _rounded(coulomb / (PRESLIDING_ANGLE if is_rotary else PRESLIDING))
    friction = Friction(
        coulomb_screw=_both(_rounded(coulomb)),
        load_coefficient=_both(LOAD_COEFFICIENT),
        initial_load=0.0,
        breakaway_gap=_both(_rounded(BREAKAWAY_GAP * coulomb)),
        stribeck_velocity=_both(STRIBECK_VELOCITY),
        viscous=_both(_rounded(viscous)),
        bristle_stiffness=_both(stiffness),
        bristle_damping=_both(_rounded(float(np.sqrt(stiffness * mass)))),
    )
    return Drive(Plant(mass, _both(0.0), constant), friction, Actuator(), sensor, motor_encoder=encoder)


def _both(value: float) -> Directional:
    return Directional(value, value)


def _rounded(value: float) -> float:
    return float(f"{value:.4g}")


def _resolution(position: np.ndarray) -> float | None:
    """The step of the position's counts, where it lies on any."""
    grid = fit_count_grid(position)
    return None if grid is None else _rounded(grid.step)
