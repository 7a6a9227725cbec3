"""Effects that change parameters, not equations: mass, friction, asymmetry of friction."""

import dataclasses
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from diffdrive.effects.base import Acts, Envelope, MachineEffect, Seen, StaticTableEffect
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional, quantity
from diffdrive.numerics.arrays import Scalar


def _scaled(pair: Directional, logarithm: Scalar) -> Directional:
    factor = jnp.exp(logarithm)
    return pair.map(lambda value: value * factor)


class PayloadMass(MachineEffect):
    """Moving mass beyond the drive file's: a workpiece, a fixture."""

    name: ClassVar[str] = "payload_mass"
    mass: Scalar = quantity("kg", "additional moving mass", default=0.0)

    def alter(self, drive: Drive) -> Drive:
        """The drive with the payload on its table."""
        return dataclasses.replace(drive, plant=dataclasses.replace(drive.plant, mass=drive.plant.mass + self.mass))


AS_LOGARITHMS = ("stribeck_velocity", "stribeck_exponent", "breakaway_gap")  # of a friction shape


class FrictionShape(MachineEffect, StaticTableEffect):
    """Another Stribeck curve: its level, its fall, its width and form, its viscous part, and that curved in speed."""

    name: ClassVar[str] = "friction_shape"
    stribeck_velocity: Scalar = quantity("1", "logarithm of the factor on the Stribeck velocity", default=0.0)
    stribeck_exponent: Scalar | None = quantity(
        "1",
        "logarithm of the factor on the Stribeck exponent; absent: 0, which costs no power",
        default=None,
    )
    breakaway_gap: Scalar = quantity("1", "logarithm of the factor on the breakaway gap", default=0.0)
    coulomb: Scalar = quantity("N", "more Coulomb friction, in both directions", default=0.0)
    viscous: Scalar = quantity("N*s/m", "more viscous friction, in both directions", default=0.0)
    curvature: Scalar = quantity("N*s^2/m^2", "growth of the viscous coefficient with speed", default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """Viscous friction that drives the table at the highest speed."""
        fastest = envelope.speed or 0.0
        for side in ("positive", "negative"):
            drag = getattr(drive.friction.viscous, side) + getattr(drive.plant.damping, side) + self.curvature * fastest
            if not np.all(np.asarray(drag) >= 0.0):
                return (
                    f"with this curvature viscous friction and damping are {np.min(drag):g} N s/m at {fastest:g} m/s: "
                    "they must not drive the table"
                )
        return None

    def alter(self, drive: Drive) -> Drive:
        """The drive with the other Stribeck curve."""
        friction = drive.friction
        exponent = friction.stribeck_exponent
        if self.stribeck_exponent is not None:
            exponent = friction.exponent * jnp.exp(self.stribeck_exponent)
        return dataclasses.replace(
            drive,
            friction=dataclasses.replace(
                friction,
                stribeck_exponent=exponent,
                coulomb_screw=friction.coulomb_screw + self.coulomb,
                stribeck_velocity=_scaled(friction.stribeck_velocity, self.stribeck_velocity),
                breakaway_gap=_scaled(friction.breakaway_gap, self.breakaway_gap),
                viscous=friction.viscous + self.viscous,
            ),
        )

    def acts(self, seen: Seen, drive: Drive, period: float) -> Acts:
        """The curved part."""
        return Acts(viscous=self.curvature * jnp.abs(seen.velocity))


class FrictionAsymmetry(MachineEffect):
    """More friction in one direction than in the other, beyond what the drive file says."""

    name: ClassVar[str] = "friction_asymmetry"
    coulomb: Scalar = quantity("N", "half the difference of Coulomb friction, positive minus negative", default=0.0)
    viscous: Scalar = quantity("N*s/m", "half the difference of viscous friction, positive minus negative", default=0.0)

    def alter(self, drive: Drive) -> Drive:
        """The drive with friction shifted from one direction to the other."""
        friction = drive.friction
        screw, viscous = friction.coulomb_screw, friction.viscous
        return dataclasses.replace(
            drive,
            friction=dataclasses.replace(
                friction,
                coulomb_screw=Directional(screw.positive + self.coulomb, screw.negative - self.coulomb),
                viscous=Directional(viscous.positive + self.viscous, viscous.negative - self.viscous),
            ),
        )
