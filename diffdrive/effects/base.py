"""Where an effect enters the drive: four interfaces, by place.

    command -> ActuatorEffect -> force -> TableEffect (adds forces, bends friction) -> table -> ScaleEffect -> measured

and `MachineEffect`, which is a drive with other parameters. An effect is a pytree of its parameters, differentiable,
and changes nothing at its neutral value. What it carries from one control period to the next is its state. The
simulator steps effects in its loop; the diagnosis steps the same code along a measured trajectory.
"""

import abc
import enum
from typing import Any, ClassVar, NamedTuple

import equinox as eqx

from diffdrive.model.parameters import Drive, Scalar


class Seen(NamedTuple):
    """The table at the beginning of a control period, as an effect sees it."""

    time: Scalar  # s, since the start of the motion
    position: Scalar  # m
    velocity: Scalar  # m/s
    bristle: Scalar  # m
    force: Scalar  # N, that the actuator applies over the coming period
    friction: Scalar  # N, all that resists the table, viscous damping included
    load: Scalar  # N, on the guides
    push: Scalar = 0.0  # N, of what else acts on the table, but for the plant's constant force
    ripple: Any = None  # N, by how much the force differs in each equal part of the period; None: not at all
    disturbance: Scalar = 0.0  # N, that an observer finds to act as well

    def external_force(self, drive: Drive) -> Scalar:
        """All that is known to act on the table beside the actuator and friction (N)."""
        return self.push + drive.plant.constant_force

    def resultant(self, drive: Drive) -> Scalar:
        """All that accelerates the table at the beginning of the period (N)."""
        return self.force + self.external_force(drive) + self.disturbance - self.friction


class Push(NamedTuple):
    """A force over the coming period."""

    mean: Scalar  # N
    slope: Scalar = 0.0  # N, by which a force in a straight line with the same first moment rises from end to end


class Acts(NamedTuple):
    """What effects add over the coming control period."""

    force: Scalar = 0.0  # N, on the table
    coulomb: Scalar = 0.0  # N, to the Coulomb friction
    gap: Scalar = 0.0  # N, to the gap between breakaway and Coulomb friction
    viscous: Scalar = 0.0  # N s/m, to the viscous friction
    shift: Scalar = 0.0  # m, by which the force's course within the period carries the table further than its mean

    def plus(self, other: "Acts") -> "Acts":
        """Both."""
        return Acts(*(a + b for a, b in zip(self, other, strict=True)))


class Envelope(NamedTuple):
    """Within what a drive is moved, as far as that is known: what is not (None) rules nothing out."""

    position: tuple[float, float] | None = None  # m, lowest and highest
    speed: float | None = None  # m/s, highest
    load: float = 0.0  # N on the guides, lowest
    duration: float | None = None  # s
    period: float | None = None  # s, of control

    @property
    def farthest(self) -> float:
        """The largest distance from 0 (m)."""
        return 0.0 if self.position is None else max(map(abs, self.position))


class Effect(eqx.Module):
    """One unmodelled effect: `name` is that of the catalogue, `part` the part of the machine that it is told as."""

    name: ClassVar[str]
    part: ClassVar[str] = "plant"

    def problem(self, drive: Drive, within: Envelope) -> str | None:
        """Why no machine can have this effect beside `drive`, or why it cannot be computed; None where it can.

        Parameters are each in their range by then; numbers, or arrays over machines. What depends on the motion is
        judged by the envelope.
        """
        return None


class MachineEffect(Effect):
    """The same kind of machine with other parameters."""

    @abc.abstractmethod
    def alter(self, drive: Drive) -> Drive:
        """The drive with the effect in its parameters."""


class Stage(enum.IntEnum):
    """Where an effect stands between command and force; force passes through them in this order.

    What is limited is the amplifier's command, as `Actuator` has it: behind a lag or a delay only the mean of a period
    would be.
    """

    SCALED = 0
    LIMITED = 1
    LAGGED = 2
    DELAYED = 3


class ActuatorEffect(Effect):
    """Between the command and the force, at its `stage` whatever its place in a drive's tuple of effects."""

    stage: ClassVar[Stage]

    @abc.abstractmethod
    def init(self, force: Scalar) -> Any:
        """State after a long time at `force` (N)."""

    @abc.abstractmethod
    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Push]:
        """The force over the coming period, of length `period` (s), when `force` (N) is asked for."""


class StepOrder(enum.IntEnum):
    """What an effect on the table has to know, in the order in which effects are stepped."""

    KINEMATIC = 0  # where the table is
    DYNAMIC = 1  # how it moves within the period, as all forces and the friction of those before drive it
    TRANSMISSION = 2  # all that pushes the table, which the motor's force reaches only through it


class TableEffect(Effect):
    """On the table and its friction; it `has_memory` where its state outlasts a tenth of a second."""

    has_memory: ClassVar[bool] = False
    order: ClassVar[StepOrder] = StepOrder.KINEMATIC

    @abc.abstractmethod
    def init(self) -> Any:
        """State at the start of a motion, at rest."""

    @abc.abstractmethod
    def step(self, state: Any, seen: Seen, drive: Drive, period: float) -> tuple[Any, Acts]:
        """State after the coming period (s), and what acts over it."""

    def substeps(self, period: float) -> int | None:
        """In how many parts it follows the table through a period, if it does so by an integrator of its own: finer
        ones of the plant would not make the motion more accurate.
        """
        return None

    def state_after_travel(self, state: Any, seen: Seen, travel: Scalar, drive: Drive, period: float) -> Any:
        """State after a period over which the table is known to travel so far (m)."""
        return self.step(state, seen, drive, period)[0]


class TableForce(TableEffect):
    """A force on the table that depends on nothing but where the table is, how it moves, and when."""

    @abc.abstractmethod
    def push(self, seen: Seen) -> Scalar:
        """The force (N) over the coming period."""

    def init(self) -> tuple[()]:
        return ()

    def step(self, state: tuple[()], seen: Seen, drive: Drive, period: float) -> tuple[tuple[()], Acts]:
        return state, Acts(force=self.push(seen))


class ScaleEffect(Effect):
    """On the measured position."""

    @abc.abstractmethod
    def error(self, position: Scalar) -> Scalar:
        """How far the scale is off (m) where the table is at `position` (m)."""
