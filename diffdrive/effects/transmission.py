"""The motor behind an elastic screw, seen from the table.

With a share s of the moving mass M on the motor's side, and a share r of the friction F on the table's, the screw's
force S and the other forces on the table (p) move it by

    (1 - s) M a = S - r F + p ,   so that the rigid drive M a = u + p - F + f needs

    f = (S - r F + p) / (1 - s) - u - p + F

beside the motor's force u. S follows from the motor's deflection q against the table,

    q'' = (u - (1 - r) F_m) / (s M) + (r F - p) / ((1 - s) M) - S / (s (1 - s) M) ,

where the motor's friction F_m is LuGre friction of its own, at the motor's velocity. Over a control period both masses
are integrated in short steps, the table from the drive's state.
"""

import abc
import math
from collections.abc import Callable
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.effects.base import Acts, Envelope, Seen, StepOrder, TableEffect
from diffdrive.effects.forces import too_many_turns
from diffdrive.model.friction import coulomb, friction_under_load, midpoint_friction
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantity
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.numerics.oscillator import DiscreteOscillator, Oscillator, discretise

LONGEST_SUBSTEP = 50e-6  # s


class Screw(NamedTuple):
    """An elastic screw between two masses."""

    gap: Scalar | None  # m, full width of the dead zone; None: there is none
    frequency: Scalar  # Hz, free resonance of motor against table in contact
    damping: Scalar  # of it
    motor_share: Scalar
    table_friction: Scalar

    def lost_motion(self, drive: Drive, force: Scalar) -> Scalar:
        """Largest deflection (m) of the motor under its force (N) or under friction."""
        reduced = self.motor_share * (1.0 - self.motor_share) * drive.plant.mass
        stiffness = reduced * (2.0 * jnp.pi * self.frequency) ** 2
        gap = 0.0 if self.gap is None else self.gap
        return 0.5 * gap + jnp.maximum(jnp.abs(force), coulomb(drive.friction, 1.0, 0.0)) / stiffness


class MotorState(NamedTuple):
    """The motor's deflection against the table, its friction's bristle (m), and both masses' last accelerations.

    The table's is not that of a rigid drive: friction acts through the screw.
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
    """Derivatives of the result of a period by one number at its beginning."""

    deflection: Scalar  # m, of the motor against the table, at the period's end
    rate: Scalar  # m/s, of that
    force: Scalar  # N, on the table
    shift: Scalar  # m, as in `Acts`


class _TwoMass(NamedTuple):
    """Motor and table between two substeps."""

    motor: MotorState
    velocity: Scalar  # m/s, of the table
    bristle: Scalar  # m, of its friction
    impulse: Scalar  # N s, of the force that the rigid drive needs beside the motor's
    impulse_integral: Scalar  # N s^2, integral of the impulse

    def acts(self, mass: Scalar, period: float) -> tuple[Scalar, Scalar]:
        """Mean force (N) and shift (m) over the period."""
        return self.impulse / period, (self.impulse_integral - 0.5 * period * self.impulse) / mass


class _Substeps(NamedTuple):
    """One control period in substeps."""

    initial: _TwoMass
    substep: Callable[[_TwoMass, Scalar | None], _TwoMass]
    steps: int
    ripple: Float[Array, " substeps"] | None
    constant: Scalar  # N, on the table throughout

    def end(self, masses: _TwoMass, drive: Drive, period: float) -> tuple[MotorState, Acts]:
        """The motor, and the force that the rigid drive needs."""
        force, shift = masses.acts(drive.plant.mass, period)
        return masses.motor, Acts(force=force + self.constant, shift=shift)


def _substeps(period: float) -> int:
    return math.ceil(round(period / LONGEST_SUBSTEP, 6))


def _discretised(screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float) -> _Substeps:
    mass, s, r = drive.plant.mass, screw.motor_share, screw.table_friction
    angular, reduced = 2.0 * jnp.pi * screw.frequency, s * (1.0 - s) * mass
    ripple_parts = 1 if seen.ripple is None else len(seen.ripple)
    count = ripple_parts * _substeps(period / ripple_parts)
    h = period / count
    external, friction, damping = (
        seen.external_force(drive),
        friction_under_load(drive.friction, seen.load),
        drive.plant.damping,
    )
    # by products: divisions cost as much as the rest of the balance
    per_motor, per_table_share = 1.0 / (s * mass), 1.0 / (1.0 - s)
    per_table = per_table_share / mass
    contact = discretise(angular, screw.damping, h)

    def substep(masses: _TwoMass, ripple: Scalar | None) -> _TwoMass:
        (q, bristle, relative_acceleration, table_acceleration), velocity, deflection, impulse, impulse_integral = (
            masses
        )
        midpoint_velocity = velocity + 0.5 * h * table_acceleration
        table_friction, deflection = midpoint_friction(friction, damping, midpoint_velocity, deflection, h)
        motor_friction, bristle = midpoint_friction(
            friction, damping, midpoint_velocity + q.rate + 0.5 * h * relative_acceleration, bristle, h
        )
        force = seen.force if ripple is None else seen.force + ripple
        push = (force - (1.0 - r) * motor_friction) * per_motor + (r * table_friction - external) * per_table
        next_relative = (
            contact.step(q, push) if screw.gap is None else _step_with_gap(contact, 0.5 * screw.gap, q, push, h)
        )
        push, next_relative = once((push, next_relative))
        relative_acceleration = (next_relative.rate - q.rate) * (1.0 / h)
        screw_force = reduced * (push - relative_acceleration)
        table_acceleration = (screw_force - r * table_friction + external) * per_table
        table_acceleration = once(table_acceleration)
        velocity = velocity + h * table_acceleration
        extra_force = (screw_force - r * table_friction) * per_table_share + table_friction
        impulse, impulse_integral = impulse + h * extra_force, impulse_integral + h * (impulse + 0.5 * h * extra_force)
        return _TwoMass(
            MotorState(next_relative, bristle, relative_acceleration, table_acceleration),
            velocity,
            deflection,
            impulse,
            impulse_integral,
        )

    zero = jnp.zeros_like(seen.velocity)
    initial = _TwoMass(motor, seen.velocity, seen.bristle, zero, zero)
    ripple = None if seen.ripple is None else jnp.repeat(seen.ripple, count // ripple_parts)
    return _Substeps(initial, substep, count, ripple, external * per_table_share - seen.force - external)


def _step_with_gap(contact: DiscreteOscillator, half: Scalar, q: Oscillator, push: Scalar, h: float) -> Oscillator:
    """The motor a substep later, with a dead zone of `half` (m) to either side."""
    midpoint = q.deflection + 0.5 * h * q.rate
    inside = jnp.clip(midpoint, -half, half)
    # exact in contact: the dead zone's edge shifts the equilibrium
    contact_state = contact.step(Oscillator(q.deflection - inside, q.rate), push)
    contact_force = push - (contact_state.rate - q.rate) * (1.0 / h)
    # the sides of a gap push, they do not pull
    touching = (half <= 0.0) | ((midpoint - inside) * contact_force > 0.0)
    free = Oscillator(q.deflection + h * q.rate + 0.5 * h**2 * push, q.rate + h * push)
    deflected = jnp.where(touching, contact_state.deflection + inside, free.deflection)
    return Oscillator(deflected, jnp.where(touching, contact_state.rate, free.rate))


def step_screw(screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float) -> tuple[MotorState, Acts]:
    """The motor one `period` (s) later, and the force that the rigid drive needs to move like the table."""
    substeps = _discretised(screw, motor, seen, drive, period)

    def body(masses: _TwoMass, ripple: Scalar | None) -> tuple[_TwoMass, None]:
        return once(substeps.substep(masses, ripple)), None

    return substeps.end(lax.scan(body, substeps.initial, substeps.ripple, length=substeps.steps)[0], drive, period)


def step_screw_with_sensitivities(
    screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float
) -> tuple[MotorState, Acts, tuple[Sensitivity, ...]]:
    """`step_screw`, and its sensitivities to the table's velocity and bristle, the motor's deflection and its rate.

    One loop carries all of them; the derivative of the loop would run it again for each.
    """
    substeps = _discretised(screw, motor, seen, drive, period)

    def body(carry: PyTree, ripple: Scalar | None) -> tuple[PyTree, None]:
        masses, tangents = carry
        masses, slope = jax.linearize(lambda one: substeps.substep(one, ripple), masses)
        return once((masses, tuple(slope(one) for one in tangents))), None

    zeros = jax.tree.map(jnp.zeros_like, substeps.initial)
    one = jnp.ones_like(seen.velocity)
    motor_zeros, relative_zeros = zeros.motor, zeros.motor.relative
    tangents = (
        zeros._replace(velocity=one),
        zeros._replace(bristle=one),
        zeros._replace(motor=motor_zeros._replace(relative=relative_zeros._replace(deflection=one))),
        zeros._replace(motor=motor_zeros._replace(relative=relative_zeros._replace(rate=one))),
    )
    (masses, tangents), _ = lax.scan(body, (substeps.initial, tangents), substeps.ripple, length=substeps.steps)
    sensitivities = tuple(Sensitivity(*one.motor.relative, *one.acts(drive.plant.mass, period)) for one in tangents)
    return (*substeps.end(masses, drive, period), sensitivities)


class Transmission(TableEffect):
    """Between motor and table, where it transmits the motor's force."""

    exclusive: ClassVar[str | None] = "screw"
    order: ClassVar[StepOrder] = StepOrder.TRANSMISSION

    @property
    @abc.abstractmethod
    def screw(self) -> Screw:
        """What connects them."""

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A resonance of so many turns in a substep that its phase is lost in rounding."""
        if envelope.period is None:
            return None
        substep = envelope.period / _substeps(envelope.period)
        return too_many_turns(np.asarray(self.screw.frequency) * substep, "a substep")

    def substeps(self, period: float) -> int:
        """Substeps of motor and table."""
        return _substeps(period)

    def init(self) -> PyTree:
        """The screw relaxed, in the middle of any dead zone."""
        return MotorState.at_rest()

    def motor_deflection(self, state: PyTree) -> Scalar:
        """That of the screw."""
        deflection: Scalar = state.relative.deflection
        return deflection

    def step(self, state: PyTree, seen: Seen, drive: Drive, period: float) -> tuple[PyTree, Acts]:
        """Free within a dead zone, an oscillator in contact, which lasts as long as it pushes."""
        return step_screw(self.screw, state, seen, drive, period)

    def step_with_sensitivities(
        self, state: PyTree, seen: Seen, drive: Drive, period: float
    ) -> tuple[PyTree, Acts, tuple[Sensitivity, ...]]:
        """`step`, and its sensitivities to the table's velocity and bristle, the motor's deflection and its rate."""
        return step_screw_with_sensitivities(self.screw, state, seen, drive, period)


class Compliance(Transmission):
    """An elastic screw: motor and table oscillate against each other. Neutral: an infinite frequency."""

    name: ClassVar[str] = "compliance"
    frequency: Scalar = quantity("Hz", "free resonance of motor against table", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio", at_least=0.0, below=1.0, default=0.03)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    @property
    def screw(self) -> Screw:
        """No dead zone."""
        return Screw(None, self.frequency, self.damping, self.motor_share, self.table_friction)


class Backlash(Transmission):
    """A dead zone between motor and table, behind an elastic screw.

    At a gap of zero the screw is always in contact, and the derivative by the gap is that of a screw in contact.
    """

    name: ClassVar[str] = "backlash"
    gap: Scalar = quantity("m", "backlash width: full width of the dead zone", at_least=0.0, default=0.0)
    frequency: Scalar = quantity("Hz", "free resonance of motor against table in contact", above=0.0, default=1e5)
    damping: Scalar = quantity("1", "damping ratio in contact", at_least=0.0, below=1.0, default=0.08)
    motor_share: Scalar = quantity("1", "of the moving mass", above=0.0, below=1.0, default=0.4)
    table_friction: Scalar = quantity(
        "1", "share of the friction on the table's side", at_least=0.0, at_most=1.0, default=0.5
    )

    @property
    def screw(self) -> Screw:
        """With its dead zone."""
        return Screw(self.gap, self.frequency, self.damping, self.motor_share, self.table_friction)
