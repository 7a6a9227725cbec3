"""Command against what mass and friction ask for: its unit where no controller tells it, and its sign."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from diffdrive.drive_file import DriveDescription
from diffdrive.logs.checks.finding import Finding
from diffdrive.logs.checks.statistics import longest_piece, mean_step, robust_fit, smoothed
from diffdrive.logs.log import Log
from diffdrive.parameters import Directional

# Nominal mass and friction are right within a factor of two even on a neglected axis; three is a unit.
UNIT_ERROR = 3.0


class Balance(NamedTuple):
    """Ratios of the command to the forces that the nominal drive asks for, over the sliding samples."""

    whole: float  # of everything
    moving: float  # of inertia and viscous drag, which scale with the unit of the position
    dry: float  # of Coulomb friction, which does not
    error: float  # of the fit of the whole, relative


def balance(log: Log, description: DriveDescription) -> Balance | None:
    """The balance of forces, or None if the table hardly moves both ways."""
    drive = description.drive
    piece, step = longest_piece(log), mean_step(log)
    position = smoothed(log.position[piece], step)
    force = log.command[piece] + (0.0 if log.disturbance is None else log.disturbance[piece])
    command = smoothed(force, step).value
    top = float(np.quantile(np.abs(position.rate), 0.999))
    sliding = np.abs(position.rate) > 0.1 * top
    ahead = position.rate > 0
    if np.sum(sliding & ahead) < 50 or np.sum(sliding & ~ahead) < 50:
        return None

    def towards(value: Directional) -> np.ndarray:
        return np.where(ahead, float(value.positive), float(value.negative))

    friction = drive.friction
    dry = towards(friction.coulomb_screw) + towards(friction.load_coefficient) * float(friction.initial_load)
    drag = (towards(drive.plant.damping) + towards(friction.viscous)) * position.rate
    inertia = float(drive.plant.mass) * position.curvature
    motion, dry = (inertia + drag)[sliding], (dry * np.sign(position.rate))[sliding]
    given = command[sliding]
    if np.std(given) == 0:
        return None
    apart = robust_fit([motion, dry], given).coefficients
    whole = robust_fit([motion + dry], given)
    return Balance(float(whole.coefficients[0]), float(apart[0]), float(apart[1]), whole.error)


def command_unit(log: Log, description: DriveDescription) -> Iterator[Finding]:
    """The unit of the command from the nominal drive alone."""
    found = balance(log, description)
    if found is None or found.error > 0.7 or found.whole <= 0:  # the nominal drive must explain half of the command
        yield Finding(
            "note",
            "command",
            "the unit of the command cannot be checked: neither the drive file's controller nor its mass and friction "
            "explain it",
            "make sure that it is in newtons on the table",
        )
        return
    if 1 / UNIT_ERROR < found.whole < UNIT_ERROR:
        return
    factor = 1 / found.whole
    yield Finding(
        "fatal",
        "command",
        f"the command is {found.whole:.3g} times what mass and friction of the drive file ask for: volts, amperes or "
        f"per cent taken as newtons? {who_is_wrong(found, found.whole)}",
        f"give the force constant (about {factor:.3g} N per unit of the command), or correct the drive file",
    )


def who_is_wrong(found: Balance | None, ratio: float) -> str:
    """Whether command or position has the wrong unit, told by Coulomb friction, which the position's does not touch."""
    if found is None or found.dry <= 0:
        return "(a wrong unit of position and reference would look alike)"
    if abs(np.log(found.dry)) > np.log(UNIT_ERROR) and abs(np.log(found.dry / abs(ratio))) < np.log(UNIT_ERROR):
        return f"(Coulomb friction says so too: it is {found.dry:.3g} times the drive file's)"
    if abs(np.log(found.dry)) < np.log(UNIT_ERROR):
        return (
            f"(but Coulomb friction is {found.dry:.3g} times the drive file's, in order: rather position and reference "
            f"are {1 / abs(ratio):.4g} times too large)"
        )
    return "(a wrong unit of position and reference would look alike)"


def command_opposes_friction(log: Log) -> Iterator[Finding]:
    """Friction costs force in the direction of motion; a command that pushes against every motion is reversed.

    Inertia and a constant force average out over motion both ways, so what is left is friction.
    """
    piece, step = longest_piece(log), mean_step(log)
    speed = smoothed(log.position[piece], step).rate
    force = log.command[piece] + (0.0 if log.disturbance is None else log.disturbance[piece])
    top = float(np.quantile(np.abs(speed), 0.999))
    ahead, back = force[speed > 0.2 * top], force[speed < -0.2 * top]
    if len(ahead) < 50 or len(back) < 50 or np.ptp(force) == 0:
        return
    loss = (float(np.median(ahead)) - float(np.median(back))) / 2
    spread = float(np.hypot(np.std(ahead), np.std(back))) / 2
    # the samples of a stroke are not independent: ask for half their spread rather than for a standard error
    if loss < -0.5 * spread and loss < 0:
        yield Finding(
            "fatal",
            "command",
            f"the command pushes against the motion, by {-loss:.4g} N both ways: its sign is reversed",
            'reverse the command, in newtons by --unit command=-N or [units] command = "-N" (in volts -V), or position '
            "and reference",
        )
