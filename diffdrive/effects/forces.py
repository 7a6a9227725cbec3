"""Effects that push or pull the table: in time, in position, through the machine's base."""

from typing import Any, ClassVar

import jax.numpy as jnp

from diffdrive.effects.base import Acts, Place, Seen, TableEffect
from diffdrive.effects.oscillator import Oscillator, swinging
from diffdrive.friction import resisting_midway, under
from diffdrive.parameters import Drive, Scalar, quantity
from diffdrive.turning import cosine_sine, doubled, tripled

EDGE = 5e-3  # s, over which a process force sets in and ends


def middle(seen: Seen, period: float) -> Scalar:
    """The table's position in the middle of the coming period (m)."""
    return seen.position + 0.5 * period * seen.velocity


def ending(seen: Seen, drive: Drive, period: float) -> Scalar:
    """The table's velocity at the end of the coming period (m/s), were its friction constant."""
    return seen.velocity + period * seen.resultant(drive) / drive.plant.mass


def window(time: Scalar, start: Scalar, end: Scalar, edge: Scalar = EDGE) -> Scalar:
    """One between `start` and `end` (s), zero outside, smooth over `edge` (s)."""
    return 0.25 * (1.0 + jnp.tanh(2.0 * (time - start) / edge)) * (1.0 - jnp.tanh(2.0 * (time - end) / edge))


class ConstantForce(TableEffect):
    """Tilt, counterbalance or amplifier offset."""

    name: ClassVar[str] = "constant_force"
    force: Scalar = quantity("N", "constant force on the table", default=0.0)

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The force."""
        return state, Acts(force=self.force)


class PositionSpring(TableEffect):
    """A cable chain or bellows: a force linear in position."""

    name: ClassVar[str] = "position_spring"
    stiffness: Scalar = quantity("N/m", "force per displacement, against it", default=0.0)
    neutral: Scalar = quantity("m", "position without force", default=0.0)

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The spring's force."""
        return state, Acts(force=-self.stiffness * (middle(seen, period) - self.neutral))


class Cogging(TableEffect):
    """Force ripple periodic in position: first, second and sixth harmonic of `period`."""

    name: ClassVar[str] = "cogging"
    period: Scalar = quantity("m", "travel from one ripple to the next", above=0.0, default=1e-3)
    cosine: Scalar = quantity("N", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("N", "amplitude of the sine", default=0.0)
    cosine2: Scalar = quantity("N", "amplitude of the cosine of the second harmonic", default=0.0)
    sine2: Scalar = quantity("N", "amplitude of the sine of the second harmonic", default=0.0)
    cosine6: Scalar = quantity("N", "amplitude of the cosine of the sixth harmonic", default=0.0)
    sine6: Scalar = quantity("N", "amplitude of the sine of the sixth harmonic", default=0.0)

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The ripple's force."""
        first = cosine_sine(2.0 * jnp.pi * middle(seen, period) / self.period)
        second = doubled(*first)
        sixth = tripled(*second)
        force = self.cosine * first[0] + self.sine * first[1] + self.cosine2 * second[0] + self.sine2 * second[1]
        return state, Acts(force=force + self.cosine6 * sixth[0] + self.sine6 * sixth[1])


class ProcessForce(TableEffect):
    """A cutting force: a mean, a vibration and its second harmonic, from `start` to `end`."""

    name: ClassVar[str] = "process_force"
    frequency: Scalar = quantity("Hz", "of the force", above=0.0, default=100.0)
    mean: Scalar = quantity("N", "mean force while it acts", default=0.0)
    cosine: Scalar = quantity("N", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("N", "amplitude of the sine", default=0.0)
    cosine2: Scalar = quantity("N", "amplitude of the cosine of the second harmonic", default=0.0)
    sine2: Scalar = quantity("N", "amplitude of the sine of the second harmonic", default=0.0)
    start: Scalar = quantity("s", "when it sets in", default=0.0)
    end: Scalar = quantity("s", "when it ends", default=1e9)

    def init(self) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The force in the middle of the coming period."""
        time = seen.time + 0.5 * period
        first = cosine_sine(2.0 * jnp.pi * self.frequency * time)
        second = doubled(*first)
        force = self.mean + self.cosine * first[0] + self.sine * first[1]
        force = force + self.cosine2 * second[0] + self.sine2 * second[1]
        return state, Acts(force=force * window(time, self.start, self.end))


class FrameVibration(TableEffect):
    """The machine's base swings under the reaction force, and the table is measured against the base.

    A base of mass M / ratio follows x_b'' + 2 zeta w x_b' + w^2 x_b = -ratio (u - F) / M, and seen from it the table
    feels -M x_b''.
    """

    name: ClassVar[str] = "frame_vibration"
    remembers: ClassVar[bool] = True
    place: ClassVar[Place] = Place.FOLLOWING
    ratio: Scalar = quantity("1", "moving mass over the base's", at_least=0.0, default=0.0)
    frequency: Scalar = quantity("Hz", "natural frequency of the base", above=0.0, default=20.0)
    damping: Scalar = quantity("1", "damping ratio of the base", at_least=0.0, default=0.03)

    def init(self) -> Any:
        """The base at rest."""
        return Oscillator.at_rest()

    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """The force of inertia seen from the base."""
        # the friction in the middle of the period: where the table sticks, it changes as fast as the table moves
        rising = seen.resultant(drive) + self.ratio * (seen.force - seen.friction)
        halfway = seen.velocity + 0.5 * period * rising / drive.plant.mass
        friction = under(drive.friction, seen.load)
        resisting = resisting_midway(friction, drive.plant.damping, halfway, seen.bristle, period)[0]
        push = -self.ratio * (seen.force - resisting) / drive.plant.mass
        ahead = swinging(2.0 * jnp.pi * self.frequency, self.damping, period).step(state, push)
        return ahead, Acts(force=-drive.plant.mass * (ahead.rate - state.rate) / period)
