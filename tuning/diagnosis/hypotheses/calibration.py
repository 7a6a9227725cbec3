"""What recalibration may move: the nominal parameters, each by its logarithm, a constant force and a delay.

Each machine may be off its drive file by a tolerance. What the file says of how well its parameters are known comes to
that, with their correlations: a constant force that the logs hardly told from the friction of either direction is then
no effect of the machine. Of a trace slower than its loop the instant of a row is known to a sample of the loop.

Under a load that never changes, nothing tells the load's share of the friction from the screw's: only their sum moves.
Left free, both would lie along a valley that is bent, since each moves by its logarithm. No fit gets along such a
valley where a fine scale tells the sum to a millionth; it stops somewhere, and the next effect seems to explain what is
left.
"""

import dataclasses
from operator import attrgetter

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
from diffdrive.model.uncertainty import MAX_LOG_DEVIATION, Deviation, Uncertainty
from diffdrive.numerics.arrays import Scalar

FORCE, DELAY = "constant_force", "row_delay"  # N and rows; as the file has them, if nothing doubts that
TOLERANCE = 0.02  # standard deviation of the logarithm of a nominal parameter
NAMES = (
    "mass",
    "coulomb_screw.positive",
    "coulomb_screw.negative",
    "load_coefficient.positive",
    "load_coefficient.negative",
    "breakaway_gap.positive",
    "breakaway_gap.negative",
    "stribeck_velocity.positive",
    "stribeck_velocity.negative",
    "viscous.positive",
    "viscous.negative",
    "bristle_stiffness",
    "bristle_damping",
    FORCE,
    DELAY,
)
LOGARITHMS = len(NAMES) - 2  # of which b has the logarithm; what it has of the others is added


def tolerated(tolerance: float) -> Float[np.ndarray, "b b"]:
    """The root of the covariance of b, in the order of `NAMES`, where each parameter has a tolerance of its own."""
    return np.diag(np.where(np.arange(len(NAMES)) < LOGARITHMS, tolerance, 0.0))


def prior_root(
    drive: Drive,
    tolerance: float,
    uncertainty: Uncertainty | None = None,
    loop_samples: int = 1,
    load: float | None = None,
) -> Float[np.ndarray, "b b"]:
    """The symmetric root of that covariance, of what the drive file says of how well it is known beside that, and of
    the instant of rows that are each one of `loop_samples`: it is equally likely anywhere within one of these.

    `load` (N) is given where it never changes.
    """
    own = tolerated(tolerance)
    if loop_samples > 1:
        own[NAMES.index(DELAY), NAMES.index(DELAY)] = 1.0 / (np.sqrt(12.0) * loop_samples)
    covariance = own @ own
    if uncertainty is not None:
        share = _shares(drive, uncertainty)
        covariance += share @ np.array(uncertainty.correlation) @ share.T
    if load is not None:
        summed = _summed(drive, load)
        covariance = summed @ covariance @ summed.T
    values, along = np.linalg.eigh(covariance)
    moves = np.diag(covariance) > 0.0  # rounding moves nothing
    return np.outer(moves, moves) * ((along * np.sqrt(np.maximum(values, 0.0))) @ along.T)


def _shares(drive: Drive, uncertainty: Uncertainty) -> Float[np.ndarray, "b k"]:
    """Of each number of the calibration, as shares of the parameters' standard normal numbers."""
    share = np.zeros((len(NAMES), len(uncertainty.names)))
    for k, (path, stated) in enumerate(zip(uncertainty.names, uncertainty.deviations, strict=True)):
        part, _, name = path.partition(".")
        for one in _meant(name):
            value = attrgetter(f"{part}.{one}")(drive)
            value = value.positive if isinstance(value, Directional) else value  # both directions move together
            share[NAMES.index(one), k] = _deviation(one, float(value), stated)
    return share


def _summed(drive: Drive, load: float) -> Float[np.ndarray, "b b"]:
    """What is said of b, as said of one where the larger of the screw's and the load's share of the Coulomb friction
    stands for both.
    """
    summed, friction = np.eye(len(NAMES)), drive.friction
    for side in ("positive", "negative"):
        forces = {
            f"coulomb_screw.{side}": float(getattr(friction.coulomb_screw, side)),
            f"load_coefficient.{side}": float(getattr(friction.load_coefficient, side))
            * (float(friction.initial_load) + load),
        }
        less, more = sorted(forces, key=lambda name: abs(forces[name]))
        if forces[more]:
            summed[NAMES.index(more), NAMES.index(less)] = forces[less] / forces[more]
            summed[NAMES.index(less)] = 0.0
    return summed


def _deviation(name: str, value: float, stated: Deviation) -> float:
    """Of a number of the calibration, as a share of a parameter's standard normal number.

    A parameter that is zero has no logarithm, and stays. Beyond `MAX_LOG_DEVIATION` nothing but its sign is known.
    """
    if name == FORCE:
        return stated.value * (abs(value) if stated.is_relative else 1.0)
    if stated.is_relative or value == 0.0:
        return stated.value if stated.is_relative else 0.0
    return float(np.clip(stated.value / value, -MAX_LOG_DEVIATION, MAX_LOG_DEVIATION))


def fraction_of_delay(drive: Drive) -> Scalar:
    """Of a control period, beyond whole ones; a drive file need not say it."""
    stated = drive.actuator.delay_fraction
    return jnp.zeros(()) if stated is None else stated


def _meant(name: str) -> list[str]:
    """The numbers of the calibration that a parameter of a drive stands for: one that has no side, for both."""
    return [one for one in NAMES if one == name or one.partition(".")[0] == name]


def calibrated(drive: Drive, b: Float[Array, " b"]) -> Drive:
    """The drive with its parameters, in the order of `NAMES`, times exp(b); constant force and delay are b more.

    Damping goes with viscous friction. The actuator's fraction of a delay may then be below zero.

    The Stribeck curve's exponent is a number then, if only 1, so that every hypothesis has the same numbers.
    """
    factor = dict(zip(NAMES, jnp.exp(b[:LOGARITHMS]), strict=False))
    plant, friction = drive.plant, drive.friction

    def scaled(pair: Directional, name: str) -> Directional:
        if name in factor:
            return Directional(pair.positive * factor[name], pair.negative * factor[name])
        return Directional(pair.positive * factor[f"{name}.positive"], pair.negative * factor[f"{name}.negative"])

    friction = dataclasses.replace(friction, stribeck_exponent=jnp.asarray(friction.exponent))
    names = dict.fromkeys(name.split(".")[0] for name in NAMES[1:LOGARITHMS])
    plant = dataclasses.replace(
        plant, mass=plant.mass * factor["mass"], damping=scaled(plant.damping, "viscous"),
        constant_force=plant.constant_force + b[NAMES.index(FORCE)],
    )  # fmt: skip
    late = fraction_of_delay(drive) + b[NAMES.index(DELAY)]
    pairs: dict[str, PyTree] = {name: scaled(getattr(friction, name), name) for name in names}
    return dataclasses.replace(
        drive, plant=plant, friction=dataclasses.replace(friction, **pairs),
        actuator=dataclasses.replace(drive.actuator, delay_fraction=late),
    )  # fmt: skip
