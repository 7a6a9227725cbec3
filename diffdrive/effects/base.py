"""Where an effect enters the drive: four interfaces, by place.

    command -> ActuatorEffect -> force -> TableEffect (adds force and friction) -> table -> ScaleEffect -> measured

and `MachineEffect`, which is a drive with other parameters. An effect is a pytree of its parameters, differentiable,
and changes nothing at its defaults. It may have a state from one control period to the next. The simulator steps
effects in its loop; the diagnosis steps the same code along a measured trajectory.
"""

import abc
import enum
from collections.abc import Mapping
from typing import ClassVar, NamedTuple, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, PyTree

from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar

Smoothed = TypeVar("Smoothed", bound="Effect")


class Seen(NamedTuple):
    """The table as an effect sees it, at the beginning of a control period where nothing else is said."""

    time: Scalar  # s, since the start of the motion
    position: Scalar  # m
    velocity: Scalar  # m/s
    bristle: Scalar  # m
    force: Scalar  # N, that the actuator applies over the coming period
    friction: Scalar  # N, all that resists the table, viscous damping included
    load: Scalar  # N, on the guides
    push: Scalar = 0.0  # N, other forces on the table, without the plant's constant force
    ripple: Float[Array, " parts"] | None = (
        None  # [parts] N, difference of the force from its mean in equal parts of the period; None: zero
    )
    disturbance: Scalar = 0.0  # N, disturbance force that a filter estimates

    def at_midpoint(self, period: float) -> "Seen":
        """The same, with the time and the position of the middle of the coming period (s)."""
        return self._replace(time=self.time + 0.5 * period, position=self.position + 0.5 * period * self.velocity)

    def external_force(self, drive: Drive) -> Scalar:
        """The known forces on the table beside the actuator's and friction (N)."""
        return self.push + drive.plant.constant_force

    def resultant(self, drive: Drive) -> Scalar:
        """The force that accelerates the table at the beginning of the period (N)."""
        return self.force + self.external_force(drive) + self.disturbance - self.friction


class Push(NamedTuple):
    """A force over the coming period."""

    mean: Scalar  # N
    slope: Scalar = 0.0  # N, rise over the period of the linear force with the same first moment


class Acts(NamedTuple):
    """What effects add over the coming control period."""

    force: Scalar = 0.0  # N, on the table
    coulomb: Scalar = 0.0  # N, to the Coulomb friction
    gap: Scalar = 0.0  # N, to the gap between breakaway and Coulomb friction
    viscous: Scalar = 0.0  # N s/m, to the viscous friction
    shift: Scalar = 0.0  # m, of the table beyond that by the mean force, since the force varies within the period

    def plus(self, other: "Acts") -> "Acts":
        """The sum of both."""
        return Acts(*(a + b for a, b in zip(self, other, strict=True)))


class Envelope(NamedTuple):
    """Bounds of a drive's motion; None where one is unknown, which excludes nothing."""

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
    """One unmodelled effect: `name` is that of the catalogue, `part` the part of the machine it belongs to.

    A drive has each effect once, and of those that are `exclusive` in the same thing, such as the screw, one.
    `from_sheet` names the parameters that an axis's data sheet states, each with the key of [axis] that does: a drive
    file may leave them out.
    """

    name: ClassVar[str]
    part: ClassVar[str] = "plant"
    exclusive: ClassVar[str | None] = None
    from_sheet: ClassVar[Mapping[str, str]] = {}

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """Why this effect on `drive` is physically impossible or cannot be computed; None where it is feasible.

        Called with parameters within their ranges: numbers, or arrays over machines. The motion is known by its
        `envelope`.
        """
        return None

    def smoothed(self: Smoothed) -> Smoothed:
        """The smooth variant, for gradients: nothing that rounds or switches (`loop.smooth`). By default itself."""
        return self

    def at_rate(self: Smoothed, share: float) -> Smoothed:
        """The same at a rate that is this share of the control's, where it counts periods. By default itself."""
        return self


class MachineEffect(Effect):
    """The same kind of machine with other parameters."""

    @abc.abstractmethod
    def alter(self, drive: Drive) -> Drive:
        """The drive with the effect in its parameters."""


class Stage(enum.IntEnum):
    """Where an effect acts between command and force, in the order of the signal.

    The limit acts on the amplifier's command, as in `Actuator`: after a lag or a delay it could only act on the mean of
    a period.
    """

    SCALED = 0
    LIMITED = 1
    LAGGED = 2
    DELAYED = 3


class ActuatorEffect(Effect):
    """Between the command and the force, at its `stage`, whatever the order of a drive's effects."""

    stage: ClassVar[Stage]

    @abc.abstractmethod
    def init(self, force: Scalar) -> PyTree:
        """State after a long time at `force` (N)."""

    def input_limit(self, output_limit: Scalar | None) -> Scalar | None:
        """The largest request (N) that is not clipped, its output being clipped at `output_limit`; None: no limit."""
        return output_limit

    @abc.abstractmethod
    def step(self, state: PyTree, force: Scalar, period: float) -> tuple[PyTree, Push]:
        """The force over the coming period, of length `period` (s), when `force` (N) is requested."""


class StaticActuatorEffect(ActuatorEffect):
    """Between the command and the force, without a state."""

    @abc.abstractmethod
    def output(self, force: Scalar) -> Scalar:
        """The force (N) when `force` (N) is requested."""

    def init(self, force: Scalar) -> tuple[()]:
        return ()

    def step(self, state: tuple[()], force: Scalar, period: float) -> tuple[tuple[()], Push]:
        return state, Push(self.output(force))


class StepOrder(enum.IntEnum):
    """The order in which effects on the table are stepped, by the inputs that they need."""

    KINEMATIC = 0  # position and velocity of the table
    DYNAMIC = 1  # its motion within the period, under the forces and friction of the effects before
    TRANSMISSION = 2  # all forces on the table, which the motor's force reaches only through this effect


class TableEffect(Effect):
    """On the table and its friction; it `has_memory` if its state lasts longer than a tenth of a second."""

    has_memory: ClassVar[bool] = False
    order: ClassVar[StepOrder] = StepOrder.KINEMATIC

    @abc.abstractmethod
    def init(self) -> PyTree:
        """State at the start of a motion, at rest."""

    @abc.abstractmethod
    def step(self, state: PyTree, seen: Seen, drive: Drive, period: float) -> tuple[PyTree, Acts]:
        """State after the coming period (s), and the forces over it."""

    def substeps(self, period: float) -> int | None:
        """Substeps in a period of its own integrator of the table; None if it has none.

        Finer substeps of the plant would not make the motion more accurate.
        """
        return None

    def state_after_travel(self, state: PyTree, seen: Seen, travel: Scalar, drive: Drive, period: float) -> PyTree:
        """State after a period over which the table travels a known distance (m)."""
        return self.step(state, seen, drive, period)[0]

    def motor_deflection(self, state: PyTree) -> Scalar:
        """How far the motor is ahead of the table (m); zero where the effect is not between them."""
        return 0.0


class StaticTableEffect(TableEffect):
    """On the table and its friction, without a state."""

    @abc.abstractmethod
    def acts(self, seen: Seen, drive: Drive, period: float) -> Acts:
        """The forces over the coming period (s)."""

    def init(self) -> tuple[()]:
        return ()

    def step(self, state: tuple[()], seen: Seen, drive: Drive, period: float) -> tuple[tuple[()], Acts]:
        return state, self.acts(seen, drive, period)


class TableForce(StaticTableEffect):
    """A force on the table without a state: a function of time and of the table's motion."""

    @abc.abstractmethod
    def push(self, seen: Seen) -> Scalar:
        """The force (N) over the coming period.

        `seen` has the time and the position of the period's midpoint, so that a force that depends on them is of second
        order in the period; its velocity is that at the beginning.
        """

    def acts(self, seen: Seen, drive: Drive, period: float) -> Acts:
        return Acts(force=self.push(seen.at_midpoint(period)))


class ScaleEffect(Effect):
    """On the measured position; `of_screw` if the error arises between motor and table.

    A scale at the table does not show an error of the screw, and a motor encoder beside it shows nothing else. Where a
    drive has one encoder, this shows all errors.
    """

    of_screw: ClassVar[bool] = False

    @abc.abstractmethod
    def error(self, position: Scalar) -> Scalar:
        """The error of the scale (m) where the table is at `position` (m)."""
