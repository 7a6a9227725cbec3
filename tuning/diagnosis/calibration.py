"""What recalibration may move: the nominal parameters, each by its logarithm."""

import dataclasses

import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional

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
)


def calibrated(drive: Drive, b: Float[Array, " b"]) -> Drive:
    """The drive with its parameters, in the order of `NAMES`, times exp(b); damping goes with viscous friction.

    The Stribeck curve's exponent is a number then, if only 1, so that every hypothesis has the same numbers.
    """
    factor = dict(zip(NAMES, jnp.exp(b), strict=True))
    plant, friction = drive.plant, drive.friction

    def scaled(pair: Directional, name: str) -> Directional:
        if name in factor:
            return Directional(pair.positive * factor[name], pair.negative * factor[name])
        return Directional(pair.positive * factor[f"{name}.positive"], pair.negative * factor[f"{name}.negative"])

    friction = dataclasses.replace(friction, stribeck_exponent=jnp.asarray(friction.exponent))
    names = dict.fromkeys(name.split(".")[0] for name in NAMES[1:])
    plant = dataclasses.replace(plant, mass=plant.mass * factor["mass"], damping=scaled(plant.damping, "viscous"))
    pairs: dict[str, PyTree] = {name: scaled(getattr(friction, name), name) for name in names}
    return dataclasses.replace(drive, plant=plant, friction=dataclasses.replace(friction, **pairs))
