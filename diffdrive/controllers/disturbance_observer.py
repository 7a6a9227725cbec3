"""The disturbance observer (DOB) that DOBVSC and PD+FF+DOB share: dhat = Q(s) (u - M s^2 x - B s x)."""

from typing import Annotated, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from diffdrive.controllers.kinds import Keys, Section
from diffdrive.model.memory import Memory
from diffdrive.model.parameters import Drive, Plant
from diffdrive.model.quantity import Directional, quantity
from diffdrive.numerics.arrays import Scalar


class DisturbanceState(NamedTuple):
    """Two lags in series, for the position and for the force.

    Those of the position are kept as output minus input: a rounding of the position itself, in the place where it is
    differenced twice, would be a force of 1e-10 N, and of newtons in single precision.
    """

    position: Annotated[Scalar, Memory("m", "measured position one period ago")]
    lags: Annotated[tuple[Scalar, Scalar], Memory("m", "lag of the measured position, output minus input")]
    force: Annotated[tuple[Scalar, Scalar], Memory("N", "lag of the force")]


class DisturbanceObserver(eqx.Module):
    """Q(s) = 1 / (tau s + 1)^2 at `cutoff`; the estimate is the force that resists the motion, N.

    The position's lags are exact for a position linear between samples; the force, constant between samples, enters its
    second lag half a sample early.
    """

    cutoff: Scalar = quantity("Hz", "cut-off frequency of each of the two lags of Q(s)", above=0.0)
    mass: Scalar = quantity("kg", "nominal mass", above=0.0)
    damping: Directional = quantity("N*s/m", "nominal damping", at_least=0.0, per_direction=True)

    @classmethod
    def of(cls, plant: Plant, cutoff: Scalar) -> "DisturbanceObserver":
        """For this plant."""
        return cls(cutoff=cutoff, mass=plant.mass, damping=plant.damping)

    def with_model(self, plant: Plant) -> "DisturbanceObserver":
        """The same cut-off for another plant."""
        return DisturbanceObserver.of(plant, self.cutoff)

    def init(self, position: Scalar) -> DisturbanceState:
        """At rest at `position`."""
        zero = jnp.zeros_like(position)
        return DisturbanceState(position + zero, (zero, zero), (zero, zero))

    def step(
        self, state: DisturbanceState, position: Scalar, force: Scalar, period: float
    ) -> tuple[DisturbanceState, Scalar]:
        """The disturbance (N); `force` (N) acted over the last period, `position` (m) is measured now."""
        tau = 1.0 / (2.0 * jnp.pi * self.cutoff)
        decay = jnp.exp(-period / tau)
        share = (1.0 - decay) * tau / period
        moved = position - state.position
        first = decay * state.lags[0] - share * moved
        second = decay * state.lags[1] - share * (moved + (first - state.lags[0]))
        force1 = decay * state.force[0] + (1.0 - decay) * force
        force2 = decay * state.force[1] + (1.0 - decay) * force1
        velocity, acceleration = -second / tau, (second - first) / tau**2
        disturbance = force2 - self.mass * acceleration - self.damping.towards(velocity) * velocity
        return DisturbanceState(position, (first, second), (force1, force2)), disturbance


# its model of the machine is that of [plant]
OBSERVER_KEYS = Keys("controller", DisturbanceObserver, frozenset({"mass", "damping"}))


def read_observer(section: Section, drive: Drive) -> DisturbanceObserver:
    """The disturbance observer that a table of a drive file specifies, with this drive as its model."""
    return section.build(DisturbanceObserver, mass=drive.plant.mass, damping=drive.plant.damping)
