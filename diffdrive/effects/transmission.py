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

import abc
import math
from collections.abc import Callable
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from diffdrive.effects.base import Acts, Envelope, Seen, StepOrder, TableEffect
from diffdrive.effects.forces import too_many_turns
from diffdrive.effects.oscillator import DiscreteOscillator, Oscillator, discretise
from diffdrive.model.friction import coulomb, friction_under_load, midpoint_friction
from diffdrive.model.parameters import Drive, Scalar, quantity
from diffdrive.numerics.once import once

LONGEST_SUBSTEP = 50e-6  # s


class Screw(NamedTuple):
    """An elastic screw between two masses."""

    gap: Scalar | None  # m, full width of the dead zone; None: there is none
    frequency: Scalar  # Hz, free resonance of motor against table in contact
    damping: Scalar  # of it
    motor_share: Scalar
    table_friction: Scalar

    def lost_motion(self, drive: Drive, force: Scalar) -> Scalar:
        """How far (m) the motor may be off under a force (N) of its own, or held by friction."""
        reduced = self.motor_share * (1.0 - self.motor_share) * drive.plant.mass
        stiffness = reduced * (2.0 * jnp.pi * self.frequency) ** 2
        gap = 0.0 if self.gap is None else self.gap
        return 0.5 * gap + jnp.maximum(jnp.abs(force), coulomb(drive.friction, 1.0, 0.0)) / stiffness


class MotorState(NamedTuple):
    """The motor's deflection against the table, its friction's bristle (m), and both masses' last accelerations.

    The table's is not that of a rigid drive: the screw carries what friction holds.
    """

    relative: Oscillator
    bristle: Scalar
    relative_acceleration: Scalar  # m/s^2, of the deflection
    table_acceleration: Scalar  # m/s^2, of the table

    @classmethod
    def at_rest(cls) -> "MotorState":
        """Nothing deflected."""
        return cls(Oscillator.at_rest(), jnp.zeros(()), jnp.zeros(()), jnp.zeros(()))


class Sensitivity(NamedTuple):
    """How motor and table answer, over a period, a change of one number at its beginning, per unit of it."""

    deflection: Scalar  # m, of the motor against the table, at the period's end
    rate: Scalar  # m/s, of that
    force: Scalar  # N, on the table
    shift: Scalar  # m, as in `Acts`


class _Pair(NamedTuple):
    """Motor and table on their way through a period."""

    motor: MotorState
    velocity: Scalar  # m/s, of the table
    bristle: Scalar  # m, of its friction
    impulse: Scalar  # N s, that the rigid drive needs beside the motor's force
    travel: Scalar  # N s^2, what that carries the table

    def acts(self, mass: Scalar, period: float) -> tuple[Scalar, Scalar]:
        """Mean force (N) and shift (m) over the period."""
        return self.impulse / period, (self.travel - 0.5 * period * self.impulse) / mass


class _Period(NamedTuple):
    """One control period in substeps."""

    begin: _Pair
    substep: Callable[[_Pair, Any], _Pair]
    count: int
    ripple: Any
    constant: Scalar  # N, that pushes the table throughout

    def end(self, pair: _Pair, drive: Drive, period: float) -> tuple[MotorState, Acts]:
        """The motor, and what the rigid drive needs."""
        force, shift = pair.acts(drive.plant.mass, period)
        return pair.motor, Acts(force=force + self.constant, shift=shift)


def _substeps(period: float) -> int:
    return math.ceil(round(period / LONGEST_SUBSTEP, 6))


def _period(screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float) -> _Period:
    mass, s, r = drive.plant.mass, screw.motor_share, screw.table_friction
    angular, reduced = 2.0 * jnp.pi * screw.frequency, s * (1.0 - s) * mass
    parts = 1 if seen.ripple is None else len(seen.ripple)
    count = parts * _substeps(period / parts)
    h = period / count
    pushed, friction, damping = (
        seen.external_force(drive),
        friction_under_load(drive.friction, seen.load),
        drive.plant.damping,
    )
    # by products: divisions cost as much as the rest of the balance
    per_motor, per_share = 1.0 / (s * mass), 1.0 / (1.0 - s)
    per_table = per_share / mass
    contact = discretise(angular, screw.damping, h)

    def substep(pair: _Pair, ripple: Any) -> _Pair:
        (q, bristle, swing, rising), velocity, deflection, impulse, travel = pair
        middle = velocity + 0.5 * h * rising
        table, deflection = midpoint_friction(friction, damping, middle, deflection, h)
        own, bristle = midpoint_friction(friction, damping, middle + q.rate + 0.5 * h * swing, bristle, h)
        force = seen.force if ripple is None else seen.force + ripple
        push = (force - (1.0 - r) * own) * per_motor + (r * table - pushed) * per_table
        ahead = contact.step(q, push) if screw.gap is None else _loose(contact, 0.5 * screw.gap, q, push, h)
        push, ahead = once((push, ahead))
        swing = (ahead.rate - q.rate) * (1.0 / h)
        pull = reduced * (push - swing)
        rising = (pull - r * table + pushed) * per_table
        rising = once(rising)
        velocity = velocity + h * rising
        more = (pull - r * table) * per_share + table
        impulse, travel = impulse + h * more, travel + h * (impulse + 0.5 * h * more)
        return _Pair(MotorState(ahead, bristle, swing, rising), velocity, deflection, impulse, travel)

    zero = jnp.zeros_like(seen.velocity)
    begin = _Pair(motor, seen.velocity, seen.bristle, zero, zero)
    ripple = None if seen.ripple is None else jnp.repeat(seen.ripple, count // parts)
    return _Period(begin, substep, count, ripple, pushed * per_share - seen.force - pushed)


def _loose(contact: DiscreteOscillator, half: Scalar, q: Oscillator, push: Scalar, h: float) -> Oscillator:
    """A motor with a dead zone of `half` to either side, a substep later."""
    midway = q.deflection + 0.5 * h * q.rate
    inside = jnp.clip(midway, -half, half)
    # exact where it touches: the dead zone's wall moves the point of rest
    there = contact.step(Oscillator(q.deflection - inside, q.rate), push)
    pressed = push - (there.rate - q.rate) * (1.0 / h)
    # the sides of a gap push, they do not hold on
    touching = (half <= 0.0) | ((midway - inside) * pressed > 0.0)
    free = Oscillator(q.deflection + h * q.rate + 0.5 * h**2 * push, q.rate + h * push)
    deflected = jnp.where(touching, there.deflection + inside, free.deflection)
    return Oscillator(deflected, jnp.where(touching, there.rate, free.rate))


def step_screw(screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float) -> tuple[MotorState, Acts]:
    """The motor one `period` (s) later, and the force that the rigid drive needs to move like the table."""
    way = _period(screw, motor, seen, drive, period)

    def body(pair: _Pair, ripple: Any) -> tuple[_Pair, None]:
        return once(way.substep(pair, ripple)), None

    return way.end(lax.scan(body, way.begin, way.ripple, length=way.count)[0], drive, period)


def step_screw_with_sensitivities(
    screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float
) -> tuple[MotorState, Acts, tuple[Sensitivity, ...]]:
    """`step_screw`, and its answers to the table's velocity and bristle and to the motor's deflection and its rate.

    All are carried through one loop; the derivative of the loop would run it anew for each.
    """
    way = _period(screw, motor, seen, drive, period)

    def body(carry: Any, ripple: Any) -> tuple[Any, None]:
        pair, tangents = carry
        pair, slope = jax.linearize(lambda one: way.substep(one, ripple), pair)
        return once((pair, tuple(slope(one) for one in tangents))), None

    nothing = jax.tree.map(jnp.zeros_like, way.begin)
    one = jnp.ones_like(seen.velocity)
    still, rest = nothing.motor, nothing.motor.relative
    tangents = (
        nothing._replace(velocity=one),
        nothing._replace(bristle=one),
        nothing._replace(motor=still._replace(relative=rest._replace(deflection=one))),
        nothing._replace(motor=still._replace(relative=rest._replace(rate=one))),
    )
    (pair, tangents), _ = lax.scan(body, (way.begin, tangents), way.ripple, length=way.count)
    answers = tuple(Sensitivity(*one.motor.relative, *one.acts(drive.plant.mass, period)) for one in tangents)
    return (*way.end(pair, drive, period), answers)


class Transmission(TableEffect):
    """Between motor and table: the motor's force reaches the table through it."""

    order: ClassVar[StepOrder] = StepOrder.TRANSMISSION

    @property
    @abc.abstractmethod
    def screw(self) -> Screw:
        """What connects them."""

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """A screw that swings so often in a substep that its phase is rounding."""
        if within.period is None:
            return None
        substep = within.period / _substeps(within.period)
        return too_many_turns(np.asarray(self.screw.frequency) * substep, "a substep")

    def substeps(self, period: float) -> int:
        """Those of motor and table."""
        return _substeps(period)

    def init(self) -> Any:
        """The screw relaxed, in the middle of any dead zone."""
        return MotorState.at_rest()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """Free within a dead zone, an oscillator in contact, which lasts as long as it pushes."""
        return step_screw(self.screw, state, seen, drive, period)

    def step_with_sensitivities(
        self, state: Any, seen: Seen, drive: Drive, period: float
    ) -> tuple[Any, Acts, tuple[Sensitivity, ...]]:
        """`step`, and its answers to the table's velocity and bristle, and to the motor's deflection and its rate."""
        return step_screw_with_sensitivities(self.screw, state, seen, drive, period)


class Compliance(Transmission):
    """An elastic screw: motor and table swing against one another. Neutral: an infinite frequency."""

    name: ClassVar[str] = "compliance"
    frequency: Scalar = quantity("Hz", "free resonance of motor against table", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio", at_least=0.0, default=0.03)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    @property
    def screw(self) -> Screw:
        """No dead zone."""
        return Screw(None, self.frequency, self.damping, self.motor_share, self.table_friction)


class Backlash(Transmission):
    """A dead zone between motor and table, behind an elastic screw."""

    name: ClassVar[str] = "backlash"
    gap: Scalar = quantity("m", "full width of the dead zone", at_least=0.0, default=0.0)
    frequency: Scalar = quantity("Hz", "free resonance of motor against table in contact", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio in contact", at_least=0.0, default=0.08)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    @property
    def screw(self) -> Screw:
        """With one."""
        return Screw(self.gap, self.frequency, self.damping, self.motor_share, self.table_friction)
