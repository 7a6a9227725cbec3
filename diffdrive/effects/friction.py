"""Effects on the friction: along the stroke, in time, with the time at rest, before sliding."""

from collections.abc import Sequence
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jax import lax

from diffdrive.effects.base import Acts, Envelope, Seen, StepOrder, TableEffect
from diffdrive.effects.forces import end_velocity, midpoint_position, too_many_turns, window
from diffdrive.model.friction import coulomb, deflection_after, friction_under_load, relaxation_map
from diffdrive.model.parameters import Directional, Drive, Scalar, quantity
from diffdrive.numerics.once import once
from diffdrive.numerics.polynomial import reciprocal
from diffdrive.numerics.relaxation import relaxation
from diffdrive.numerics.trigonometry import cosine_sine

STROKE_POINTS, POINTS_PER_WAVE = (
    4096,
    32,
)  # places along a stroke at which a level is looked at, and of them in each wave
ELEMENTS = 6  # Maxwell elements of presliding hysteresis
SUBSTEP = 1e-4  # s, in which they are stepped


class AppliedLoad(TableEffect):
    """A normal load on the guides that nobody told the model: constant, and more of it between two times."""

    name: ClassVar[str] = "applied_load"
    load: Scalar = quantity("N", "constant normal load", default=0.0)
    more: Scalar = quantity("N", "further normal load from `start` to `end`", default=0.0)
    start: Scalar = quantity("s", "when it is put on", default=0.0)
    end: Scalar = quantity("s", "when it is taken off", default=1e9)
    edge: Scalar = quantity("s", "how long that takes", above=0.0, default=0.05)

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """A load that lifts the table off its guides, or leaves it without friction."""
        least = np.asarray(self.load) + np.minimum(self.more, 0.0)
        pressed = drive.friction.initial_load + within.load + least
        if np.any(pressed < 0.0):
            return (
                f"a load of {np.min(least):g} N lifts the table off its guides, which initial_load and the load press "
                f"with {np.min(drive.friction.initial_load + within.load):g} N"
            )
        levels = [
            getattr(drive.friction.coulomb_screw, side) + getattr(drive.friction.load_coefficient, side) * pressed
            for side in ("positive", "negative")
        ]
        if any(np.any(np.asarray(level) <= 0.0) for level in levels):
            return f"a load of {np.min(least):g} N leaves no Coulomb friction: it must stay above 0"
        return None

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """Coulomb friction in proportion."""
        load = self.load + self.more * window(seen.time, self.start, self.end, self.edge)
        return state, Acts(coulomb=drive.friction.load_coefficient.towards(seen.velocity) * load)


class PositionFriction(TableEffect):
    """Coulomb friction that varies along the stroke: a slope, and a wave."""

    name: ClassVar[str] = "position_friction"
    slope: Scalar = quantity("1/m", "share of Coulomb friction per travel", default=0.0)
    neutral: Scalar = quantity("m", "where the slope adds nothing", default=0.0)
    period: Scalar = quantity("m", "travel from one crest of the wave to the next", above=0.0, default=0.1)
    cosine: Scalar = quantity("1", "share of Coulomb friction, cosine", default=0.0)
    sine: Scalar = quantity("1", "share of Coulomb friction, sine", default=0.0)

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """Friction that is gone, or drives the table, at some place of the stroke."""
        height = np.hypot(self.cosine, self.sine)
        low, high = within.position or (0.0, 0.0)
        if np.any(height > 0.0):
            turns = within.farthest / np.asarray(self.period)
            if problem := too_many_turns(turns, "the way from 0 to the end of the stroke"):
                return problem
        short = POINTS_PER_WAVE * (high - low) / np.asarray(self.period) > STROKE_POINTS
        if within.position is None:
            least = -height
        else:
            slope, neutral, period, height, cosine, sine, short = np.broadcast_arrays(
                self.slope, self.neutral, self.period, height, self.cosine, self.sine, short
            )
            at = np.linspace(low, high, STROKE_POINTS).reshape(-1, *[1] * slope.ndim)
            along = slope * (at - neutral)
            angle = 2.0 * np.pi * at / period
            wave = np.where(short, -height, cosine * np.cos(angle) + sine * np.sin(angle))
            least = np.min(along + wave, axis=0)
        if np.all(1.0 + least > 0.0):
            return None
        return f"it takes {-100 * np.min(least):.4g} % of the Coulomb friction off at some place: less than all must go"

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The share of the Coulomb friction here."""
        at = midpoint_position(seen, period)
        cosine, sine = cosine_sine(2.0 * jnp.pi * at / self.period)
        share = self.slope * (at - self.neutral) + self.cosine * cosine + self.sine * sine
        return state, Acts(coulomb=share * coulomb(drive.friction, seen.velocity, seen.load))


class ViscousDrift(TableEffect):
    """Friction that falls as the machine warms up: viscous, and Coulomb friction along with it."""

    name: ClassVar[str] = "viscous_drift"
    viscous: Scalar = quantity("1", "share of viscous friction that goes", default=0.0)
    coulomb: Scalar = quantity("1", "share of Coulomb friction that goes", default=0.0)
    time_constant: Scalar = quantity("s", "in which all but a share of 1 / e has gone", above=0.0, default=5.0)

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """Friction that is gone, or drives the table, while the machine is cold."""
        if np.any(np.asarray(self.viscous) < -1.0):
            return f"viscous = {np.min(self.viscous):g} takes off more viscous friction than there is: -1 is all of it"
        if np.any(np.asarray(self.coulomb) <= -1.0):
            return f"coulomb = {np.min(self.coulomb):g} leaves no Coulomb friction: it must be above -1"
        return None

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """What is still there."""
        left = jnp.exp(-seen.time / self.time_constant)
        both = drive.friction.viscous.towards(seen.velocity) + drive.plant.damping.towards(seen.velocity)
        level = coulomb(drive.friction, seen.velocity, seen.load)
        return state, Acts(viscous=self.viscous * left * both, coulomb=self.coulomb * left * level)


def _mean_speed(before: Scalar, after: Scalar) -> Scalar:
    """Mean of |v| over a period in which v goes from one value to the other in a straight line.

    At rest noise in the loop shakes the table to and fro: half of |v| at the samples, and it is forgotten later.
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

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """Breakaway that is gone once the table has rested."""
        oldest = np.asarray(self.rested) + (within.duration or 0.0)
        grown = 1.0 + np.asarray(self.growth) * np.log1p(oldest / np.asarray(self.onset))
        for side in ("positive", "negative"):
            guide = getattr(drive.friction.load_coefficient, side) * (drive.friction.initial_load + within.load)
            gap = getattr(drive.friction.breakaway_gap, side)
            breakaway = getattr(drive.friction.coulomb_screw, side) + guide + gap * grown
            if not np.all(np.asarray(breakaway) > 0.0):
                return (
                    f"the breakaway friction in the {side} direction falls to {np.min(breakaway):g} N at rest: it must "
                    "stay above 0"
                )
        return None

    def init(self) -> Any:
        """The contact's age (s)."""
        return jnp.asarray(self.rested)

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The gap grown with age."""
        half = 0.5 * period
        speed = _mean_speed(seen.velocity, end_velocity(seen, drive, period))
        fade = relaxation(half * speed, self.slip)  # the age's equation is a bristle's
        share = reciprocal(fade.common_denominator)
        left, gained = once((fade.remaining * share, half * fade.mean * share))
        midway = left * state + gained
        gap = drive.friction.breakaway_gap.towards(seen.velocity)
        return left * midway + gained, Acts(gap=self.growth * gap * jnp.log1p(midway / self.onset))


class PreslidingHysteresis(TableEffect):
    """Maxwell elements of several slip distances in the place of the one bristle, or of a share of it.

    What acts is the difference between the elements and a bristle, both stretched by the same motion: nothing in
    steady sliding, another hysteresis before it. An element holds with the friction level of the direction in which it
    is stretched, so that nothing jumps where the table turns. (Generalised Maxwell-slip: Al-Bender, Lampaert, Swevers
    2005.)
    """

    name: ClassVar[str] = "presliding_hysteresis"
    has_memory: ClassVar[bool] = True
    order: ClassVar[StepOrder] = StepOrder.DYNAMIC
    share: Scalar = quantity("1", "of the bristle that elements replace", default=0.0)
    longest: Scalar = quantity("m", "longest slip distance", above=0.0, default=5e-6)
    shortest: Scalar = quantity("1", "shortest slip distance over the longest", above=0.0, default=0.2)

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """Elements and bristle that together push the table away from where it rests."""
        softness = sum(1.0 / (np.asarray(self.longest) * part) for part in self._spread()) / ELEMENTS
        for side in ("positive", "negative"):
            stiffness = getattr(drive.friction.bristle_stiffness, side)
            guide = getattr(drive.friction.load_coefficient, side) * (drive.friction.initial_load + within.load)
            held = (getattr(drive.friction.coulomb_screw, side) + guide) * softness
            total = (1.0 - np.asarray(self.share)) * stiffness + self.share * held
            if not np.all(total > 0.0):
                return f"the stiffness before sliding becomes {np.min(total):.3g} N/m: it must stay above 0"
        return None

    def _spread(self) -> list[Scalar]:
        """The elements' slip distances over the longest."""
        return [self.shortest + (1.0 - self.shortest) * k / (ELEMENTS - 1) for k in range(ELEMENTS)]

    def init(self) -> Any:
        """How far each element is stretched, in units of its slip distance, and the bristle's deflection (m)."""
        return (jnp.zeros(()),) * (ELEMENTS + 1)

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """Each element sticks or slips, and the bristle bends, as the forces move the table within the period.

        A reversal is over within milliseconds: a velocity held over the period of a log would be far off. Midpoint
        rule, in steps of about `SUBSTEP`.
        """
        *elements, deflection = state
        steps = max(1, round(period / SUBSTEP))
        duration, friction = period / steps, friction_under_load(drive.friction, seen.load)
        lightness = 1.0 / drive.plant.mass

        def held(levels: Directional, stretched: Sequence[Scalar]) -> Scalar:
            return once(sum(one * levels.towards(one) for one in stretched) * (1.0 / ELEMENTS))

        def body(carry: Any, _: None) -> Any:
            elements, bristle, velocity, impulse, travel = carry
            stiffness = friction.stiffness.towards(bristle)
            levels = once(friction.levels(velocity))
            at = friction.coefficients_at_level(levels.towards(velocity), velocity, bristle)
            more = held(levels, elements) - stiffness * bristle
            resisting = stiffness * bristle + at.damping * (velocity - at.rate * bristle) + self.share * more
            mean = once(velocity + (pushed - resisting) * (0.5 * duration * lightness))
            levels = once(friction.levels(mean))
            ahead = once(self._stretched(elements, duration * mean))
            stays, drawn = relaxation_map(stiffness, levels.towards(mean), mean, duration)
            bent = stays * bristle + drawn
            midway = [0.5 * (one + other) for one, other in zip(elements, ahead, strict=True)]
            bending = stiffness * 0.5 * (bristle + bent)
            more = held(levels, midway) - bending
            damping = friction.damping.towards(mean)
            resisting = bending + damping * (bent - bristle) * (1.0 / duration) + self.share * more
            velocity = velocity + (pushed - resisting) * (duration * lightness)
            travel = travel + duration * (impulse + 0.5 * duration * more)
            return (ahead, bent, velocity, impulse + duration * more, travel), None

        drag = friction.viscous.towards(seen.velocity) + drive.plant.damping.towards(seen.velocity)
        pushed = (
            seen.force + seen.external_force(drive) + seen.disturbance - drag * seen.velocity
        )  # by all but the bristle
        zero = jnp.zeros_like(seen.velocity)
        begin = (tuple(elements), deflection, seen.velocity, zero, zero)
        (stretched, bent, _, impulse, travel), _ = lax.scan(body, begin, None, length=steps)
        shift = (0.5 * period * impulse - travel) * lightness
        return (*stretched, bent), Acts(force=-self.share * impulse / period, shift=self.share * shift)

    def state_after_travel(self, state: Any, seen: Seen, travel: Scalar, drive: Drive, period: float) -> Any:
        """What stretches the elements and bends the bristle is the travel; no force has to be known."""
        *elements, deflection = state
        at = friction_under_load(drive.friction, seen.load).at(travel / period, deflection)
        return (*self._stretched(elements, travel), deflection_after(deflection, travel / period, at.rate, period))

    def _stretched(self, elements: Sequence[Scalar], travel: Scalar) -> tuple[Scalar, ...]:
        pairs = zip(elements, self._spread(), strict=True)
        return tuple(jnp.clip(one + travel / (self.longest * part), -1.0, 1.0) for one, part in pairs)
