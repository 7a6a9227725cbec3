"""What identification looks for, in coordinates in which every value is possible and the data speak plainly.

Friction at no applied load is stated by its levels, Coulomb F_C and breakaway F_S, which the force shows directly; a
drive file states the screw's share and the gap F_S - F_C, which follow from them. Of damping and viscous friction only
the sum acts. So a drive becomes `Unknowns`, these are fitted, and they become a drive again.
"""

import dataclasses

import equinox as eqx
import jax.numpy as jnp

from diffdrive.model.parameters import Drive, Plant
from diffdrive.model.quantity import Directional, node_at, quantity, with_nodes
from diffdrive.numerics.arrays import Scalar
from tuning.identification.row_force import MAX_DELAY, MIN_DELAY
from tuning.optimisation.space import FreeParameter


class Unknowns(eqx.Module):
    """Parameters of the machine, shared by all logs."""

    mass: Scalar = quantity("kg", "moving mass", above=0.0)
    constant_force: Scalar = quantity("N", "constant force on the table")
    coulomb: Directional = quantity("N", "Coulomb friction at no applied load, F_C", above=0.0, per_direction=True)
    load_coefficient: Directional = quantity("1", "Coulomb friction per load, mu_LC", above=0.0, per_direction=True)
    breakaway: Directional | None = quantity(
        "1", "breakaway over Coulomb friction, F_S / F_C; None: the gap as believed", per_direction=True, optional=True
    )
    stribeck_velocity: Directional = quantity("m/s", "Stribeck velocity, v_s", above=0.0, per_direction=True)
    viscous: Directional = quantity("N*s/m", "damping and viscous friction, B_S + mu_v", above=0.0, per_direction=True)
    bristle_stiffness: Directional = quantity("N/m", "bristle stiffness, sigma_0", above=0.0, per_direction=True)
    bristle_damping: Directional = quantity("N*s/m", "bristle damping, sigma_1", above=0.0, per_direction=True)
    delay: Scalar = quantity("1", "delay from command to force, in control periods")
    compliance: Scalar | None = quantity(
        "m/N", "wind-up of the screw per newton of friction; None: no second encoder shows it", default=None
    )

    def drive(self, believed: Drive) -> Drive:
        """`believed` with these parameters in place of its own; its delay excepted (see `with_delay`)."""
        friction, damping = believed.friction, believed.plant.damping
        gap = friction.breakaway_gap
        if self.breakaway is not None:
            gap = self.coulomb.map(lambda level, ratio: level * (ratio - 1.0), self.breakaway)
        return dataclasses.replace(
            believed,
            plant=Plant(
                mass=self.mass,
                damping=damping.map(jnp.minimum, self.viscous),
                constant_force=self.constant_force,
            ),
            friction=dataclasses.replace(
                friction,
                coulomb_screw=self.coulomb.map(
                    lambda level, slope: level - slope * friction.initial_load, self.load_coefficient
                ),
                load_coefficient=self.load_coefficient,
                breakaway_gap=gap,
                stribeck_velocity=self.stribeck_velocity,
                viscous=self.viscous.map(lambda both, known: jnp.maximum(both - known, 0.0), damping),
                bristle_stiffness=self.bristle_stiffness,
                bristle_damping=self.bristle_damping,
            ),
        )


# of which logs may leave several answers: searches begin at several values
MULTIMODAL = ("breakaway", "stribeck_velocity", "bristle_stiffness", "bristle_damping", "delay")
LOGARITHM_FLOOR = {
    "load_coefficient": 1e-5,
    "viscous": 1.0,
    "bristle_damping": 10.0,
}  # what moves in a logarithm cannot start at 0
MAX_FACTOR = 30.0  # factor by which a parameter may move from its start, either way
STIFFEST = 1e9  # N/m: a short thick screw, a rack; what is stiffer winds up by nanometres under a kilonewton


def unknowns_of(drive: Drive, delay: float) -> Unknowns:
    """The unknowns at the values of `drive`, and a delay (control periods)."""
    plant, friction = drive.plant, drive.friction
    level = friction.coulomb_at(0.0).map(float)
    return Unknowns(
        mass=float(plant.mass),
        constant_force=float(plant.constant_force),
        coulomb=level,
        load_coefficient=friction.load_coefficient,
        breakaway=level.map(lambda coulomb, gap: (coulomb + float(gap)) / coulomb, friction.breakaway_gap),
        stribeck_velocity=friction.stribeck_velocity,
        viscous=(plant.damping + friction.viscous).map(float),
        bristle_stiffness=friction.bristle_stiffness,
        bristle_damping=friction.bristle_damping,
        delay=float(delay),
    )


def free_paths(unknowns: Unknowns) -> list[str]:
    """Every path that can be free: both directions of friction each, but for a bristle that is the same in both."""
    found = []
    for field in dataclasses.fields(unknowns):
        value = getattr(unknowns, field.name)
        if value is None:
            continue
        together = field.name.startswith("bristle") and float(value.positive) == float(value.negative)
        if isinstance(value, Directional) and not together:
            found += [f"{field.name}.positive", f"{field.name}.negative"]
        else:
            found.append(field.name)
    return found


def default_bounds(path: str, start: float, friction: float) -> FreeParameter:
    """How far a parameter may move by default; `friction` is the Coulomb level (N)."""
    if path == "constant_force":
        reach = 10.0 * friction + 2.0 * abs(start)
        return FreeParameter(path, -reach, reach)
    if path == "delay":
        return FreeParameter(path, float(MIN_DELAY), float(MAX_DELAY))
    if path == "compliance":  # of either sign, so that none lies within its interval
        reach = MAX_FACTOR * max(abs(start), 1.0 / STIFFEST)
        return FreeParameter(path, -reach, reach)
    middle = max(start, LOGARITHM_FLOOR.get(path.split(".")[0], 0.0))
    return FreeParameter(path, middle / MAX_FACTOR, middle * MAX_FACTOR)


def value_at(unknowns: Unknowns, path: str) -> float:
    """The value at `path`; of a pair that is the same in both directions, that one."""
    node = node_at(unknowns, path)
    return float(node.positive if isinstance(node, Directional) else node)


def with_value(unknowns: Unknowns, path: str, value: float) -> Unknowns:
    """The unknowns with `value` at `path`, in both directions where the path names a pair."""
    is_pair = isinstance(node_at(unknowns, path), Directional)
    return with_nodes(unknowns, {path: Directional(value, value) if is_pair else value})
