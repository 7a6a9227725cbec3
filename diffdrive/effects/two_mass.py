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

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.effects.base import Acts, Seen
from diffdrive.model.friction import (
    LoadedFriction,
    coulomb,
    friction_under_load,
    midpoint_friction,
    midpoint_friction_with_slopes,
)
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional
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


class _Contact(NamedTuple):
    """What a screw with a dead zone does over a substep."""

    edge: Scalar  # m, the point of the dead zone that is nearest to the motor
    touching: Scalar  # whether the screw pushes


class _Transition(NamedTuple):
    """The motor's answer over a substep to small changes of its state and its push.

    The dead zone's edge has no part in it: in contact it stands still, and while the motor is free it does not act.
    """

    deflection: Scalar
    rate: Scalar  # s, of the rate
    push: Scalar  # s^2
    rate_by_deflection: Scalar  # 1/s
    rate_by_rate: Scalar
    rate_by_push: Scalar  # s

    def along(self, q: Oscillator, push: Scalar) -> Oscillator:
        """Of the motor, for such changes."""
        return Oscillator(
            self.deflection * q.deflection + self.rate * q.rate + self.push * push,
            self.rate_by_deflection * q.deflection + self.rate_by_rate * q.rate + self.rate_by_push * push,
        )


def _midpoint(q: Oscillator, h: float) -> Scalar:
    return q.deflection + 0.5 * h * q.rate


class _TwoMassStep(NamedTuple):
    """One substep of motor and table: friction at the midpoint's velocities, and all else linear in it and the state.

    By products: divisions cost as much as the rest of the balance.
    """

    oscillator: DiscreteOscillator
    half_gap: Scalar | None  # m
    friction: LoadedFriction
    damping: Directional
    table_friction: Scalar  # share
    per_motor: Scalar  # 1/kg, of the motor's mass
    per_table: Scalar  # 1/kg, of the table's
    per_table_share: Scalar  # one over the table's share of the mass
    reduced_mass: Scalar  # kg
    external: Scalar  # N, on the table
    h: float  # s

    def velocities(self, masses: _TwoMass) -> tuple[Scalar, Scalar]:
        """Of table and motor, in the middle of the substep: linear in the state."""
        table = masses.velocity + 0.5 * self.h * masses.motor.table_acceleration
        return table, table + masses.motor.relative.rate + 0.5 * self.h * masses.motor.relative_acceleration

    def push(self, table_friction: Scalar, motor_friction: Scalar, force: Scalar, external: Scalar) -> Scalar:
        """What moves the motor against the table beside the screw (m/s^2): linear."""
        r = self.table_friction
        return (force - (1.0 - r) * motor_friction) * self.per_motor + (r * table_friction - external) * self.per_table

    def contact(self, q: Oscillator, push: Scalar) -> _Contact | None:
        """What the screw does under that push; None where it is always in contact."""
        if self.half_gap is None:
            return None
        midpoint = _midpoint(q, self.h)
        edge = jnp.clip(midpoint, -self.half_gap, self.half_gap)
        rate = self.oscillator.step(Oscillator(q.deflection - edge, q.rate), push).rate
        contact_force = push - (rate - q.rate) * (1.0 / self.h)
        # the sides of a gap push, they do not pull
        touching = (self.half_gap <= 0.0) | ((midpoint - edge) * contact_force > 0.0)
        return _Contact(edge, touching)

    def relative(self, q: Oscillator, push: Scalar, contact: _Contact | None) -> Oscillator:
        """The motor against the table a substep later."""
        if contact is None:
            return self.oscillator.step(q, push)
        # exact in contact: the dead zone's edge shifts the equilibrium
        touching = self.oscillator.step(Oscillator(q.deflection - contact.edge, q.rate), push)
        free = Oscillator(q.deflection + self.h * q.rate + 0.5 * self.h**2 * push, q.rate + self.h * push)
        deflected = jnp.where(contact.touching, touching.deflection + contact.edge, free.deflection)
        return Oscillator(deflected, jnp.where(contact.touching, touching.rate, free.rate))

    def transition(self, contact: _Contact | None) -> _Transition:
        """How that answers small changes."""
        one, h = self.oscillator, self.h
        cosine, sine = one.cosine + one.sine * one.decay_rate, one.sine
        touching = (
            cosine, sine, (1.0 - cosine) * one.compliance,
            -sine * one.frequency_squared, one.cosine - sine * one.decay_rate, sine,
        )  # fmt: skip
        if contact is None:
            return _Transition(*touching)
        free = (1.0, h, 0.5 * h**2, 0.0, 1.0, h)
        chosen = [jnp.where(contact.touching, a, b) for a, b in zip(touching, free, strict=True)]
        return _Transition._make(chosen)

    def ahead(
        self,
        masses: _TwoMass,
        frictions: tuple[Scalar, Scalar],
        push: Scalar,
        relative: Oscillator,
        external: Scalar,
    ) -> _TwoMass:
        """Both masses at the end of the substep, whose bristles are yet where they were: linear."""
        h, rate = self.h, masses.motor.relative.rate
        relative_acceleration = (relative.rate - rate) * (1.0 / h)
        screw_force = self.reduced_mass * (push - relative_acceleration)
        on_table = screw_force - self.table_friction * frictions[0]
        table_acceleration = once((on_table + external) * self.per_table)
        extra_force = on_table * self.per_table_share + frictions[0]
        return masses._replace(
            motor=MotorState(relative, masses.motor.bristle, relative_acceleration, table_acceleration),
            velocity=masses.velocity + h * table_acceleration,
            impulse=masses.impulse + h * extra_force,
            impulse_integral=masses.impulse_integral + h * (masses.impulse + 0.5 * h * extra_force),
        )

    def value(self, masses: _TwoMass, force: Scalar) -> _TwoMass:
        """Both masses a substep later under the motor's force (N)."""
        velocities, given, q = self.velocities(masses), (self.friction, self.damping), masses.motor.relative
        table, bristle = midpoint_friction(*given, velocities[0], masses.bristle, self.h)
        motor, motor_bristle = midpoint_friction(*given, velocities[1], masses.motor.bristle, self.h)
        push = self.push(table, motor, force, self.external)
        push, relative = once((push, self.relative(q, push, self.contact(q, push))))
        return _with_bristles(self.ahead(masses, (table, motor), push, relative, self.external), bristle, motor_bristle)

    def with_tangents(
        self, masses: _TwoMass, force: Scalar, tangents: tuple[_TwoMass, ...]
    ) -> tuple[_TwoMass, tuple[_TwoMass, ...]]:
        """`value`, and how it answers small changes of the state.

        By the chain rule, with the four derivatives of each friction: through every operation a tangent costs several
        times as much.
        """
        velocities, given, q = self.velocities(masses), (self.friction, self.damping), masses.motor.relative
        (table, bristle), by_table = midpoint_friction_with_slopes(*given, velocities[0], masses.bristle, self.h)
        (motor, motor_bristle), by_motor = midpoint_friction_with_slopes(
            *given, velocities[1], masses.motor.bristle, self.h
        )
        push = self.push(table, motor, force, self.external)
        contact = self.contact(q, push)
        push, relative, by_table, by_motor, transition = once(
            (push, self.relative(q, push, contact), by_table, by_motor, self.transition(contact))
        )

        def along(tangent: _TwoMass) -> _TwoMass:
            velocities = self.velocities(tangent)
            table, bristle = by_table.along(velocities[0], tangent.bristle)
            motor, motor_bristle = by_motor.along(velocities[1], tangent.motor.bristle)
            push = self.push(table, motor, 0.0, 0.0)
            relative = transition.along(tangent.motor.relative, push)
            return _with_bristles(self.ahead(tangent, (table, motor), push, relative, 0.0), bristle, motor_bristle)

        ahead = self.ahead(masses, (table, motor), push, relative, self.external)
        return _with_bristles(ahead, bristle, motor_bristle), tuple(map(along, tangents))


def _with_bristles(masses: _TwoMass, table: Scalar, motor: Scalar) -> _TwoMass:
    return masses._replace(bristle=table, motor=masses.motor._replace(bristle=motor))


class _Substeps(NamedTuple):
    """One control period in substeps."""

    initial: _TwoMass
    step: _TwoMassStep
    number: int
    force: Scalar  # N, of the motor
    ripple: Float[Array, " substeps"] | None
    constant: Scalar  # N, on the table throughout

    def force_with(self, ripple: Scalar | None) -> Scalar:
        """The motor's in a substep."""
        return self.force if ripple is None else self.force + ripple

    def end(self, masses: _TwoMass, drive: Drive, period: float) -> tuple[MotorState, Acts]:
        """The motor, and the force that the rigid drive needs."""
        force, shift = masses.acts(drive.plant.mass, period)
        return masses.motor, Acts(force=force + self.constant, shift=shift)


def substeps_of(period: float) -> int:
    """Into how many a period (s) is divided."""
    return math.ceil(round(period / LONGEST_SUBSTEP, 6))


def _discretised(screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float) -> _Substeps:
    ripple_parts = 1 if seen.ripple is None else len(seen.ripple)
    count = ripple_parts * substeps_of(period / ripple_parts)
    h = period / count
    mass, s, external = drive.plant.mass, screw.motor_share, seen.external_force(drive)
    per_table_share = 1.0 / (1.0 - s)
    step = _TwoMassStep(
        oscillator=discretise(2.0 * jnp.pi * screw.frequency, screw.damping, h),
        half_gap=None if screw.gap is None else 0.5 * screw.gap,
        friction=friction_under_load(drive.friction, seen.load),
        damping=drive.plant.damping,
        table_friction=screw.table_friction,
        per_motor=1.0 / (s * mass),
        per_table=per_table_share / mass,
        per_table_share=per_table_share,
        reduced_mass=s * (1.0 - s) * mass,
        external=external,
        h=h,
    )
    zero = jnp.zeros_like(seen.velocity)
    initial = _TwoMass(motor, seen.velocity, seen.bristle, zero, zero)
    ripple = None if seen.ripple is None else jnp.repeat(seen.ripple, count // ripple_parts)
    constant = external * per_table_share - seen.force - external
    return _Substeps(initial, step, count, seen.force, ripple, constant)


def step_screw(screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float) -> tuple[MotorState, Acts]:
    """The motor one `period` (s) later, and the force that the rigid drive needs to move like the table."""
    substeps = _discretised(screw, motor, seen, drive, period)

    def body(masses: _TwoMass, ripple: Scalar | None) -> tuple[_TwoMass, None]:
        return once(substeps.step.value(masses, substeps.force_with(ripple))), None

    return substeps.end(lax.scan(body, substeps.initial, substeps.ripple, length=substeps.number)[0], drive, period)


def step_screw_with_sensitivities(
    screw: Screw, motor: MotorState, seen: Seen, drive: Drive, period: float
) -> tuple[MotorState, Acts, tuple[Sensitivity, ...]]:
    """`step_screw`, and its sensitivities to the table's velocity and bristle, the motor's deflection and its rate.

    One loop carries all of them; the derivative of the loop would run it again for each.
    """
    substeps = _discretised(screw, motor, seen, drive, period)

    def body(carry: PyTree, ripple: Scalar | None) -> tuple[PyTree, None]:
        masses, tangents = carry
        return once(substeps.step.with_tangents(masses, substeps.force_with(ripple), tangents)), None

    zeros = jax.tree.map(jnp.zeros_like, substeps.initial)
    one = jnp.ones_like(seen.velocity)
    motor_zeros, relative_zeros = zeros.motor, zeros.motor.relative
    tangents = (
        zeros._replace(velocity=one),
        zeros._replace(bristle=one),
        zeros._replace(motor=motor_zeros._replace(relative=relative_zeros._replace(deflection=one))),
        zeros._replace(motor=motor_zeros._replace(relative=relative_zeros._replace(rate=one))),
    )
    (masses, tangents), _ = lax.scan(body, (substeps.initial, tangents), substeps.ripple, length=substeps.number)
    sensitivities = tuple(Sensitivity(*one.motor.relative, *one.acts(drive.plant.mass, period)) for one in tangents)
    return (*substeps.end(masses, drive, period), sensitivities)
