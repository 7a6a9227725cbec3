"""Which parameters the inverse-dynamics model has: each term gives the columns that its parameters multiply.

    command + disturbance = M a + Fv v + (Fc + mu W) sign(v) - constant_force

A parameter per direction is named `viscous.positive`, `viscous.negative` and so on. Coulomb friction per direction and
a constant force cannot be told apart, whatever the motion: c newtons of constant force are c newtons more of friction
forwards and c less backwards. So `SYMMETRIC` has one Coulomb friction and a constant force, and `DIRECTIONAL` two
Coulomb frictions and none.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

Signal = Float[np.ndarray, " n"]


class Kinematics(NamedTuple):
    """Velocity (m/s), acceleration (m/s2) and applied load (N), [n] each."""

    velocity: Signal
    acceleration: Signal
    load: Signal


Columns = dict[str, Signal]
Term = Callable[[Kinematics], Columns]


def _per_direction(name: str, column: Signal, velocity: Signal) -> Columns:
    return {
        f"{name}.positive": np.where(velocity > 0, column, 0.0),
        f"{name}.negative": np.where(velocity < 0, column, 0.0),
    }


def inertia(kinematics: Kinematics) -> Columns:
    """M a."""
    return {"mass": kinematics.acceleration}


def viscous(kinematics: Kinematics) -> Columns:
    """Fv v, friction and damping of the system together."""
    return {"viscous": kinematics.velocity}


def viscous_per_direction(kinematics: Kinematics) -> Columns:
    """Fv v, another Fv in each direction."""
    return _per_direction("viscous", kinematics.velocity, kinematics.velocity)


def coulomb(kinematics: Kinematics) -> Columns:
    """Fc sign(v)."""
    return {"coulomb": np.sign(kinematics.velocity)}


def coulomb_per_direction(kinematics: Kinematics) -> Columns:
    """Fc sign(v), another Fc in each direction."""
    return _per_direction("coulomb", np.sign(kinematics.velocity), kinematics.velocity)


def constant_force(kinematics: Kinematics) -> Columns:
    """What pulls the table in one direction always; it spares the motor that force."""
    return {"constant_force": -np.ones_like(kinematics.velocity)}


def load_slope(kinematics: Kinematics) -> Columns:
    """Coulomb friction in proportion to the load, mu W sign(v)."""
    return {"load_coefficient": kinematics.load * np.sign(kinematics.velocity)}


def load_slope_per_direction(kinematics: Kinematics) -> Columns:
    """Coulomb friction in proportion to the load, another mu in each direction."""
    return _per_direction("load_coefficient", kinematics.load * np.sign(kinematics.velocity), kinematics.velocity)


@dataclass(frozen=True)
class Regressors:
    """The terms of a model, and the one that joins them where the applied loads differ."""

    name: str
    terms: tuple[Term, ...]
    load_term: Term

    def with_load(self) -> "Regressors":
        """The same with the Coulomb friction's slope over the load among its terms."""
        return Regressors(f"{self.name}, with load", (*self.terms, self.load_term), self.load_term)

    def columns(self, kinematics: Kinematics) -> Columns:
        """All columns by the names of their parameters, [n] each."""
        return {name: column for term in self.terms for name, column in term(kinematics).items()}


SYMMETRIC = Regressors("symmetric", (inertia, viscous, coulomb, constant_force), load_slope)
DIRECTIONAL = Regressors(
    "directional", (inertia, viscous_per_direction, coulomb_per_direction), load_slope_per_direction
)
