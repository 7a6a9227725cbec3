"""Effects on the friction: along the stroke, over time, by time at rest, and in presliding."""

import dataclasses
from collections.abc import Sequence
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

from diffdrive.effects.base import Acts, Envelope, Seen, StaticTableEffect, StepOrder, TableEffect
from diffdrive.effects.forces import end_velocity, too_many_turns, window
from diffdrive.model.friction import coulomb, deflection_after, friction_under_load, relaxation_map
from diffdrive.model.parameters import Drive, friction_problem
from diffdrive.model.quantity import Directional, quantity
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import reciprocal
from diffdrive.numerics.relaxation import relaxation
from diffdrive.numerics.trigonometry import cosine_sine

STROKE_POINTS, POINTS_PER_WAVE = (
    4096,
    32,
)  # points along a stroke at which the friction is evaluated, and least of them in each wave
ELEMENTS = 6  # Maxwell elements of presliding hysteresis
SUBSTEP = 1e-4  # s, of their integration


class AppliedLoad(StaticTableEffect):
    """A normal load on the guides that the model does not have: constant, and more of it between two times."""

    name: ClassVar[str] = "applied_load"
    load: Scalar = quantity("N", "constant normal load", default=0.0)
    more: Scalar = quantity("N", "further normal load from `start` to `end`", default=0.0)
    start: Scalar = quantity("s", "when it is put on", default=0.0)
    end: Scalar = quantity("s", "when it is taken off", default=1e9)
    edge: Scalar = quantity("s", "how long that takes", above=0.0, default=0.05)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A load that lifts the table off its guides, or leaves it with friction that no machine has."""
        least = np.asarray(self.load) + np.minimum(self.more, 0.0)
        normal_force = drive.friction.initial_load + envelope.load + least
        if np.any(normal_force < 0.0):
            return (
                f"a load of {np.min(least):g} N lifts the table off its guides, which initial_load and the load press "
                f"with {np.min(drive.friction.initial_load + envelope.load):g} N"
            )
        problem = friction_problem(drive.friction, envelope.load + least)
        return None if problem is None else f"with a load of {np.min(least):g} N {problem}"

    def acts(self, seen: Seen, drive: Drive, period: float) -> Acts:
        """Coulomb friction in proportion."""
        load = self.load + self.more * window(seen.time, self.start, self.end, self.edge)
        return Acts(coulomb=drive.friction.load_coefficient.towards(seen.velocity) * load)


class PositionFriction(StaticTableEffect):
    """Coulomb friction that varies along the stroke: a slope, and a wave."""

    name: ClassVar[str] = "position_friction"
    slope: Scalar = quantity("1/m", "share of Coulomb friction per travel", default=0.0)
    neutral: Scalar = quantity("m", "where the slope adds nothing", default=0.0)
    period: Scalar = quantity("m", "travel from one crest of the wave to the next", above=0.0, default=0.1)
    cosine: Scalar = quantity("1", "share of Coulomb friction, cosine", default=0.0)
    sine: Scalar = quantity("1", "share of Coulomb friction, sine", default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """Friction that is gone, or drives the table, at some place of the stroke."""
        height = np.hypot(self.cosine, self.sine)
        low, high = envelope.position or (0.0, 0.0)
        if np.any(height > 0.0):
            turns = envelope.farthest / np.asarray(self.period)
            if problem := too_many_turns(turns, "the way from 0 to the end of the stroke"):
                return problem
        short = POINTS_PER_WAVE * (high - low) / np.asarray(self.period) > STROKE_POINTS
        if envelope.position is None:
            least = -height
        else:
            slope, neutral, period, height, cosine, sine, short = np.broadcast_arrays(
                self.slope, self.neutral, self.period, height, self.cosine, self.sine, short
            )
            positions = np.linspace(low, high, STROKE_POINTS).reshape(-1, *[1] * slope.ndim)
            trend = slope * (positions - neutral)
            angle = 2.0 * np.pi * positions / period
            wave = np.where(short, -height, cosine * np.cos(angle) + sine * np.sin(angle))
            least = np.min(trend + wave, axis=0)
        if np.all(1.0 + least > 0.0):
            return None
        return f"it takes {-100 * np.min(least):.4g} % of the Coulomb friction off at some place: less than all must go"

    def acts(self, seen: Seen, drive: Drive, period: float) -> Acts:
        """The share of the Coulomb friction here."""
        position = seen.at_midpoint(period).position
        cosine, sine = cosine_sine(2.0 * jnp.pi * position / self.period)
        share = self.slope * (position - self.neutral) + self.cosine * cosine + self.sine * sine
        return Acts(coulomb=share * coulomb(drive.friction, seen.velocity, seen.load))


class ViscousDrift(StaticTableEffect):
    """Friction that falls as the machine warms up: viscous, and Coulomb friction along with it."""

    name: ClassVar[str] = "viscous_drift"
    viscous: Scalar = quantity("1", "share of viscous friction that goes", default=0.0)
    coulomb: Scalar = quantity("1", "share of Coulomb friction that goes", default=0.0)
    time_constant: Scalar = quantity("s", "in which all but a share of 1 / e has gone", above=0.0, default=5.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """Friction that is gone, or drives the table, while the machine is cold."""
        if np.any(np.asarray(self.viscous) < -1.0):
            return f"viscous = {np.min(self.viscous):g} takes off more viscous friction than there is: -1 is all of it"
        if np.any(np.asarray(self.coulomb) <= -1.0):
            return f"coulomb = {np.min(self.coulomb):g} leaves no Coulomb friction: it must be above -1"
        return None

    def acts(self, seen: Seen, drive: Drive, period: float) -> Acts:
        """The drift that remains."""
        remaining = jnp.exp(-seen.time / self.time_constant)
        viscous_sum = drive.friction.viscous.towards(seen.velocity) + drive.plant.damping.towards(seen.velocity)
        level = coulomb(drive.friction, seen.velocity, seen.load)
        return Acts(viscous=self.viscous * remaining * viscous_sum, coulomb=self.coulomb * remaining * level)


def _mean_speed(before: Scalar, after: Scalar) -> Scalar:
    """Mean of |v| over a period in which v changes linearly from one value to the other.

    At rest noise in the loop moves the table to and fro: the mean is then half of |v| at the samples.
    """
    total = jnp.abs(before) + jnp.abs(after)
    turning = 0.5 * (before**2 + after**2) / jnp.where(total > 0.0, total, 1.0)
    return jnp.where(before * after > 0.0, 0.5 * total, turning)


class FrictionDwell(TableEffect):
    """Breakaway that grows with the logarithm of the contact's age, d age/dt = 1 - |v| age / D (Dieterich)."""

    name: ClassVar[str] = "friction_dwell"
    order: ClassVar[StepOrder] = StepOrder.DYNAMIC
    growth: Scalar = quantity("1", "growth of the breakaway gap per e-fold of time at rest", default=0.0)
    onset: Scalar = quantity("s", "time at rest from which it grows", above=0.0, default=0.1)
    slip: Scalar = quantity("m", "travel over which it is forgotten", above=0.0, default=1e-5)
    rested: Scalar = quantity("s", "time at rest before the motion", at_least=0.0, default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """Breakaway that is gone once the table has rested."""
        max_age = np.asarray(self.rested) + (envelope.duration or 0.0)
        growth = 1.0 + np.asarray(self.growth) * np.log1p(max_age / np.asarray(self.onset))
        rested = dataclasses.replace(
            drive.friction, breakaway_gap=drive.friction.breakaway_gap.map(lambda gap: gap * growth)
        )
        problem = friction_problem(rested, envelope.load)
        return None if problem is None else f"at rest {problem}"

    def init(self) -> PyTree:
        """The contact's age (s)."""
        return jnp.asarray(self.rested)

    def step(self, state: PyTree, seen: Seen, drive: Drive, period: float) -> tuple[PyTree, Acts]:
        """The gap grown with age."""
        half = 0.5 * period
        speed = _mean_speed(seen.velocity, end_velocity(seen, drive, period))
        shares = relaxation(half * speed, self.slip)  # the age obeys the equation of a bristle
        per_denominator = reciprocal(shares.common_denominator)
        remaining, gained = once((shares.remaining * per_denominator, half * shares.mean * per_denominator))
        midpoint_age = remaining * state + gained
        gap = drive.friction.breakaway_gap.towards(seen.velocity)
        return remaining * midpoint_age + gained, Acts(gap=self.growth * gap * jnp.log1p(midpoint_age / self.onset))


class PreslidingHysteresis(TableEffect):
    """Maxwell elements of several slip distances in place of the bristle, or of a share of it.

    The force is the difference between the elements and a bristle under the same motion: zero in steady sliding,
    another hysteresis before it. An element has the friction level of the direction in which it is stretched, so that
    the force is continuous at reversals. (Generalised Maxwell-slip: Al-Bender, Lampaert, Swevers 2005.)
    """

    name: ClassVar[str] = "presliding_hysteresis"
    has_memory: ClassVar[bool] = True
    order: ClassVar[StepOrder] = StepOrder.DYNAMIC
    share: Scalar = quantity("1", "of the bristle that elements replace", default=0.0)
    longest: Scalar = quantity("m", "longest slip distance", above=0.0, default=5e-6)
    shortest: Scalar = quantity("1", "shortest slip distance over the longest", above=0.0, default=0.2)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """Elements and bristle whose stiffness together is negative."""
        mean_inverse_slip = (
            sum(1.0 / (np.asarray(self.longest) * fraction) for fraction in self._slip_fractions()) / ELEMENTS
        )
        for side in ("positive", "negative"):
            stiffness = getattr(drive.friction.bristle_stiffness, side)
            element_stiffness = getattr(drive.friction.coulomb_at(envelope.load), side) * mean_inverse_slip
            total = (1.0 - np.asarray(self.share)) * stiffness + self.share * element_stiffness
            if not np.all(total > 0.0):
                return f"the stiffness before sliding becomes {np.min(total):.3g} N/m: it must stay above 0"
        return None

    def _slip_fractions(self) -> list[Scalar]:
        """The elements' slip distances over the longest."""
        return [self.shortest + (1.0 - self.shortest) * k / (ELEMENTS - 1) for k in range(ELEMENTS)]

    def init(self) -> PyTree:
        """The elongation of each element over its slip distance, and the bristle's deflection (m)."""
        return (jnp.zeros(()),) * (ELEMENTS + 1)

    def step(self, state: PyTree, seen: Seen, drive: Drive, period: float) -> tuple[PyTree, Acts]:
        """Elements and bristle follow the table as the forces move it within the period.

        A reversal takes milliseconds, so a velocity constant over the period of a log would be far off. Midpoint rule,
        in steps of about `SUBSTEP`.
        """
        *elements, deflection = state
        steps = max(1, round(period / SUBSTEP))
        duration, friction = period / steps, friction_under_load(drive.friction, seen.load)
        inverse_mass = 1.0 / drive.plant.mass

        def mean_force(levels: Directional, stretched: Sequence[Scalar]) -> Scalar:
            return once(sum(element * levels.towards(element) for element in stretched) * (1.0 / ELEMENTS))

        def body(carry: PyTree, _: None) -> tuple[PyTree, None]:
            elements, bristle, velocity, impulse, travel = carry
            stiffness = friction.stiffness.towards(bristle)
            levels = once(friction.levels(velocity))
            coefficients = friction.coefficients_at_level(levels.towards(velocity), velocity, bristle)
            difference = mean_force(levels, elements) - stiffness * bristle
            resistance = (
                stiffness * bristle
                + coefficients.damping * (velocity - coefficients.rate * bristle)
                + self.share * difference
            )
            mean = once(velocity + (applied_force - resistance) * (0.5 * duration * inverse_mass))
            levels = once(friction.levels(mean))
            next_elements = once(self._stretch(elements, duration * mean))
            remaining, gained = relaxation_map(stiffness, levels.towards(mean), mean, duration)
            next_bristle = remaining * bristle + gained
            midpoint_elements = [
                0.5 * (element + next_element) for element, next_element in zip(elements, next_elements, strict=True)
            ]
            bristle_force = stiffness * 0.5 * (bristle + next_bristle)
            difference = mean_force(levels, midpoint_elements) - bristle_force
            damping = friction.damping.towards(mean)
            resistance = bristle_force + damping * (next_bristle - bristle) * (1.0 / duration) + self.share * difference
            velocity = velocity + (applied_force - resistance) * (duration * inverse_mass)
            travel = travel + duration * (impulse + 0.5 * duration * difference)
            return (next_elements, next_bristle, velocity, impulse + duration * difference, travel), None

        drag = friction.viscous.towards(seen.velocity) + drive.plant.damping.towards(seen.velocity)
        applied_force = (
            seen.force + seen.external_force(drive) + seen.disturbance - drag * seen.velocity
        )  # all forces but the bristle's
        zero = jnp.zeros_like(seen.velocity)
        initial = (tuple(elements), deflection, seen.velocity, zero, zero)
        (stretched, next_bristle, _, impulse, travel), _ = lax.scan(body, initial, None, length=steps)
        shift = (0.5 * period * impulse - travel) * inverse_mass
        return (*stretched, next_bristle), Acts(force=-self.share * impulse / period, shift=self.share * shift)

    def state_after_travel(self, state: PyTree, seen: Seen, travel: Scalar, drive: Drive, period: float) -> PyTree:
        """Elements and bristle follow the travel; no force is needed."""
        *elements, deflection = state
        coefficients = friction_under_load(drive.friction, seen.load).at(travel / period, deflection)
        return (
            *self._stretch(elements, travel),
            deflection_after(deflection, travel / period, coefficients.rate, period),
        )

    def _stretch(self, elements: Sequence[Scalar], travel: Scalar) -> tuple[Scalar, ...]:
        pairs = zip(elements, self._slip_fractions(), strict=True)
        return tuple(jnp.clip(element + travel / (self.longest * fraction), -1.0, 1.0) for element, fraction in pairs)
