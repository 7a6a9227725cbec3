"""Effects that push or pull the table: in time, in position, through the machine's base."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import PyTree

from diffdrive.effects.base import Acts, Envelope, Seen, StepOrder, TableEffect, TableForce
from diffdrive.model.friction import friction_under_load, midpoint_friction
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantity
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.oscillator import Oscillator, discretise
from diffdrive.numerics.trigonometry import MAX_TURNS, cosine_sine, double_angle, triple_angle

EDGE_TIME = 5e-3  # s, rise and fall time of a process force


def end_velocity(seen: Seen, drive: Drive, period: float) -> Scalar:
    """The table's velocity at the end of the coming period (m/s) if its friction were constant."""
    return seen.velocity + period * seen.resultant(drive) / drive.plant.mass


def window(time: Scalar, start: Scalar, end: Scalar, edge: Scalar = EDGE_TIME) -> Scalar:
    """One between `start` and `end` (s), zero outside, smooth over `edge` (s)."""
    return 0.25 * (1.0 + jnp.tanh(2.0 * (time - start) / edge)) * (1.0 - jnp.tanh(2.0 * (time - end) / edge))


def too_stiff(stiffness: Scalar | np.ndarray, drive: Drive, envelope: Envelope) -> str | None:
    """Why a force with this gradient (N/m, of either sign) cannot be computed; None where it can.

    Each period T has one force: with k T^2 / M above 1 it reverses the table within a period, or doubles its travel.
    """
    if envelope.period is None:
        return None
    max_stiffness = np.min(drive.plant.mass) / envelope.period**2
    largest = float(np.max(np.abs(stiffness)))
    if largest <= max_stiffness:
        return None
    return (
        f"its force changes by {largest:.3g} N/m along the stroke, more than the {max_stiffness:.3g} N/m that moving "
        "mass and control period resolve: check its units"
    )


def too_many_turns(turns: Scalar | np.ndarray, noun: str) -> str | None:
    """Why a wave of so many turns cannot be computed, its phase being lost in rounding; None where it can."""
    largest = float(np.max(np.abs(turns)))
    if largest <= MAX_TURNS:
        return None
    return f"{noun} is {largest:.3g} of its waves, of which {MAX_TURNS:g} can be resolved: check its units"


class ConstantForce(TableForce):
    """Tilt, counterbalance or amplifier offset."""

    name: ClassVar[str] = "constant_force"
    force: Scalar = quantity("N", "constant force on the table", default=0.0)

    def push(self, seen: Seen) -> Scalar:
        """The force."""
        return self.force


class PositionSpring(TableForce):
    """A cable chain or bellows: a force linear in position."""

    name: ClassVar[str] = "position_spring"
    stiffness: Scalar = quantity("N/m", "force per displacement, against it", default=0.0)
    neutral: Scalar = quantity("m", "position without force", default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A spring that swings faster than the control samples."""
        return too_stiff(self.stiffness, drive, envelope)

    def push(self, seen: Seen) -> Scalar:
        """The spring's force."""
        return -self.stiffness * (seen.position - self.neutral)


class Cogging(TableForce):
    """Force ripple periodic in position: first, second and sixth harmonic of `period`."""

    name: ClassVar[str] = "cogging"
    period: Scalar = quantity("m", "travel from one ripple to the next", above=0.0, default=1e-3)
    cosine: Scalar = quantity("N", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("N", "amplitude of the sine", default=0.0)
    cosine2: Scalar = quantity("N", "amplitude of the cosine of the second harmonic", default=0.0)
    sine2: Scalar = quantity("N", "amplitude of the sine of the second harmonic", default=0.0)
    cosine6: Scalar = quantity("N", "amplitude of the cosine of the sixth harmonic", default=0.0)
    sine6: Scalar = quantity("N", "amplitude of the sine of the sixth harmonic", default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A ripple so short that its phase is rounding, or so steep that a period of control steps over it."""
        first, second, sixth = (
            np.hypot(self.cosine, self.sine),
            np.hypot(self.cosine2, self.sine2),
            np.hypot(self.cosine6, self.sine6),
        )
        height = first + 2.0 * second + 6.0 * sixth
        if not np.any(height > 0.0):
            return None
        turns = envelope.farthest / np.asarray(self.period)
        return too_many_turns(turns, "the way from 0 to the end of the stroke") or too_stiff(
            2.0 * np.pi * height / np.asarray(self.period), drive, envelope
        )

    def push(self, seen: Seen) -> Scalar:
        """The ripple's force."""
        first = cosine_sine(2.0 * jnp.pi * seen.position / self.period)
        second = double_angle(*first)
        sixth = triple_angle(*second)
        force = self.cosine * first[0] + self.sine * first[1] + self.cosine2 * second[0] + self.sine2 * second[1]
        return force + self.cosine6 * sixth[0] + self.sine6 * sixth[1]


class ProcessForce(TableForce):
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

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A vibration that one force in each control period cannot show."""
        if not any(
            np.any(np.asarray(amplitude) != 0.0) for amplitude in (self.cosine, self.sine, self.cosine2, self.sine2)
        ):
            return None
        if envelope.period is not None and np.any(np.asarray(self.frequency) * envelope.period >= 0.5):
            max_frequency = 0.5 / envelope.period
            frequency = np.max(self.frequency)
            return f"its {frequency:g} Hz are beyond half of the control rate, {max_frequency:g} Hz: lower them"
        turns = np.asarray(self.frequency) * (envelope.duration or 0.0)
        return too_many_turns(turns, "the motion's duration")

    def push(self, seen: Seen) -> Scalar:
        """The force in the middle of the coming period."""
        first = cosine_sine(2.0 * jnp.pi * self.frequency * seen.time)
        second = double_angle(*first)
        force = self.mean + self.cosine * first[0] + self.sine * first[1]
        force = force + self.cosine2 * second[0] + self.sine2 * second[1]
        return force * window(seen.time, self.start, self.end)


class FrameVibration(TableEffect):
    """The machine's base swings under the reaction force, and the table is measured against the base.

    A base of mass M / ratio follows x_b'' + 2 zeta w x_b' + w^2 x_b = -ratio (u - F) / M, and seen from it the table
    feels -M x_b''.
    """

    name: ClassVar[str] = "frame_vibration"
    has_memory: ClassVar[bool] = True
    order: ClassVar[StepOrder] = StepOrder.DYNAMIC
    ratio: Scalar = quantity("1", "moving mass over the base's", at_least=0.0, default=0.0)
    frequency: Scalar = quantity("Hz", "natural frequency of the base", above=0.0, default=20.0)
    damping: Scalar = quantity("1", "damping ratio of the base", at_least=0.0, below=1.0, default=0.03)

    def init(self) -> PyTree:
        """The base at rest."""
        return Oscillator.at_rest()

    def step(self, state: PyTree, seen: Seen, drive: Drive, period: float) -> tuple[PyTree, Acts]:
        """The force of inertia seen from the base."""
        # the friction in the middle of the period: where the table sticks, it changes as fast as the table moves
        net_force = seen.resultant(drive) + self.ratio * (seen.force - seen.friction)
        midpoint_velocity = seen.velocity + 0.5 * period * net_force / drive.plant.mass
        friction = friction_under_load(drive.friction, seen.load)
        resistance = midpoint_friction(friction, drive.plant.damping, midpoint_velocity, seen.bristle, period)[0]
        push = -self.ratio * (seen.force - resistance) / drive.plant.mass
        next_state = discretise(2.0 * jnp.pi * self.frequency, self.damping, period).step(state, push)
        return next_state, Acts(force=-drive.plant.mass * (next_state.rate - state.rate) / period)
