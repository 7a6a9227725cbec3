"""The motor behind an elastic screw, seen from the table.

With a share s of the moving mass M on the motor's side, and a share r of the friction F on the table's, the screw's
force S and what else pushes the table (p) move it by

    (1 - s) M a = S - r F + p ,   so that the rigid drive M a = u + p - F + f needs

    f = (S - r F + p) / (1 - s) - u - p + F

beside the motor's force u. S follows from the motor's deflection q against the table,

    q'' = (u - (1 - r) F_m) / (s M) + (r F - p) / ((1 - s) M) - S / (s (1 - s) M) ,

where the motor's friction F_m is LuGre friction of its own, at the motor's velocity. Over a control period both masses
are followed in short steps, the table from where the drive has it.
"""

from typing import Any, ClassVar, NamedTuple

import jax.numpy as jnp
from jax import lax

from diffdrive.effects.base import Acts, Place, Seen, TableEffect
from diffdrive.effects.oscillator import Oscillator, swinging
from diffdrive.friction import coulomb, resisting_midway, under
from diffdrive.parameters import Drive, Scalar, quantity

LONGEST_SUBSTEP = 50e-6  # s
REGAINED = 0.01  # s, in which an observer brings the motor to the side of the gap from which it pushes


class Screw(NamedTuple):
    """An elastic screw between two masses."""

    gap: Scalar  # m, full width of the dead zone
    frequency: Scalar  # Hz, free resonance of motor against table in contact
    damping: Scalar  # of it
    motor_share: Scalar
    table_friction: Scalar


class Motor(NamedTuple):
    """The motor's deflection against the table, its friction's bristle (m), and both masses' last accelerations.

    The table's is not that of a rigid drive: the screw carries what friction holds.
    """

    against: Oscillator
    bristle: Scalar
    swing: Scalar  # m/s^2, of the deflection
    rising: Scalar  # m/s^2, of the table

    @classmethod
    def at_rest(cls) -> "Motor":
        """Nothing deflected."""
        return cls(Oscillator.at_rest(), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))


def driven(screw: Screw, motor: Motor, seen: Seen, drive: Drive, period: float) -> tuple[Motor, Acts]:
    """The motor one `period` (s) later, and the force that the rigid drive needs to move like the table."""
    mass, s, r = drive.plant.mass, screw.motor_share, screw.table_friction
    angular, half, reduced = 2.0 * jnp.pi * screw.frequency, 0.5 * screw.gap, s * (1.0 - s) * mass
    parts = 1 if seen.ripple is None else len(seen.ripple)
    count = parts * max(1, round(period / (parts * LONGEST_SUBSTEP)))
    h = period / count
    pushed, friction, damping = seen.pushes(drive), under(drive.friction, seen.load), drive.plant.damping
    # by products: divisions cost as much as the rest of the balance
    per_motor, per_share = 1.0 / (s * mass), 1.0 / (1.0 - s)
    per_table = per_share / mass
    contact = swinging(angular, screw.damping, h)

    def substep(carry: Any, ripple: Any) -> tuple[Any, None]:
        (q, bristle, swing, rising), velocity, deflection, impulse, travel = carry
        middle = velocity + 0.5 * h * rising
        table, deflection = resisting_midway(friction, damping, middle, deflection, h)
        own, bristle = resisting_midway(friction, damping, middle + q.rate + 0.5 * h * swing, bristle, h)
        force = seen.force if ripple is None else seen.force + ripple
        push = (force - (1.0 - r) * own) * per_motor + (r * table - pushed) * per_table
        midway = q.deflection + 0.5 * h * q.rate
        inside = jnp.clip(midway, -half, half)
        # exact where it touches: the dead zone's wall moves the point of rest
        there = contact.step(Oscillator(q.deflection - inside, q.rate), push)
        pressed = reduced * (push - (there.rate - q.rate) * (1.0 / h))
        # the sides of a gap push, they do not hold on
        touching = (half <= 0.0) | ((midway - inside) * pressed > 0.0)
        free = Oscillator(q.deflection + h * q.rate + 0.5 * h**2 * push, q.rate + h * push)
        deflected = jnp.where(touching, there.deflection + inside, free.deflection)
        ahead = Oscillator(deflected, jnp.where(touching, there.rate, free.rate))
        swing = (ahead.rate - q.rate) * (1.0 / h)
        pull = reduced * (push - swing)
        rising = (pull - r * table + pushed) * per_table
        velocity = velocity + h * rising
        more = (pull - r * table) * per_share + table
        impulse, travel = impulse + h * more, travel + h * (impulse + 0.5 * h * more)
        carry = (Motor(ahead, bristle, swing, rising), velocity, deflection, impulse, travel)
        return lax.optimization_barrier(carry), None

    zero = jnp.zeros_like(seen.velocity)
    begin = (motor, seen.velocity, seen.bristle, zero, zero)
    ripple = None if seen.ripple is None else jnp.repeat(seen.ripple, count // parts)
    (motor, *_, impulse, travel), _ = lax.scan(substep, begin, ripple, length=count)
    force = impulse / period + pushed * per_share - seen.force - pushed
    return motor, Acts(force=force, shift=(travel - 0.5 * period * impulse) / mass)


class Compliance(TableEffect):
    """An elastic screw: motor and table swing against one another. Neutral: an infinite frequency."""

    name: ClassVar[str] = "compliance"
    place: ClassVar[Place] = Place.BETWEEN
    frequency: Scalar = quantity("Hz", "free resonance of motor against table", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio", at_least=0.0, default=0.03)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    def init(self) -> Any:
        """The screw relaxed."""
        return Motor.at_rest()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """No dead zone."""
        screw = Screw(0.0 * self.frequency, self.frequency, self.damping, self.motor_share, self.table_friction)
        return driven(screw, state, seen, drive, period)


class Backlash(TableEffect):
    """A dead zone between motor and table, behind an elastic screw."""

    name: ClassVar[str] = "backlash"
    place: ClassVar[Place] = Place.BETWEEN
    gap: Scalar = quantity("m", "full width of the dead zone", at_least=0.0, default=0.0)
    frequency: Scalar = quantity("Hz", "free resonance of motor against table in contact", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio in contact", at_least=0.0, default=0.08)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    def init(self) -> Any:
        """In the middle of the dead zone."""
        return Motor.at_rest()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """Free within the dead zone, an oscillator in contact, which lasts as long as it pushes."""
        screw = Screw(self.gap, self.frequency, self.damping, self.motor_share, self.table_friction)
        return driven(screw, state, seen, drive, period)

    def nudged(self, state: Any, lacking: Scalar, drive: Drive, period: float) -> Any:
        """The motor moved towards the side from which it would push so."""
        level = coulomb(drive.friction, 1.0, 0.0)
        stiffness = (
            self.motor_share * (1.0 - self.motor_share) * drive.plant.mass * (2.0 * jnp.pi * self.frequency) ** 2
        )
        moved = period / REGAINED * lacking / level * (self.gap + level / stiffness)
        q = state.against
        return state._replace(against=q._replace(deflection=q.deflection + moved))
