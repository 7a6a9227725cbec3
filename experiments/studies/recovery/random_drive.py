"""Drives drawn around the paper's, for studies of how well a drive can be identified."""

import dataclasses
from typing import Any

import numpy as np

from diffdrive.model.parameters import Drive, Friction, Plant
from diffdrive.model.presets import paper_drive
from diffdrive.model.quantity import Directional
from experiments.studies.recovery.truth import SCALE

SPREAD = 0.4


def random_drive(rng: np.random.Generator, spread: float = SPREAD) -> Drive:
    """The paper's drive with each parameter times an independent uniform factor within 1 -+ `spread`.

    Directional parameters have a factor per direction, the bristle's stiffness and damping one for both, for they
    belong to the contact and not to the direction. The initial load stays: without applied load only its product with
    the load coefficient acts. The scale is that of `truth`: 0.1 um, 30 nm of noise.
    """

    def factor() -> float:
        return rng.uniform(1.0 - spread, 1.0 + spread)

    def varied(value: Directional, common: bool = False) -> Directional:
        positive = factor()
        return Directional(value.positive * positive, value.negative * (positive if common else factor()))

    nominal = paper_drive()
    plant = Plant(mass=nominal.plant.mass * factor(), damping=varied(nominal.plant.damping))
    per_direction = ("coulomb_screw", "load_coefficient", "breakaway_gap", "stribeck_velocity", "viscous")
    common = ("bristle_stiffness", "bristle_damping")
    changed: dict[str, Any] = {name: varied(getattr(nominal.friction, name)) for name in per_direction}
    changed |= {name: varied(getattr(nominal.friction, name), common=True) for name in common}
    friction: Friction = dataclasses.replace(nominal.friction, **changed)
    return Drive(plant, friction, nominal.actuator, SCALE)
