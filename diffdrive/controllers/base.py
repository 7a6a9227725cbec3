"""The one interface of all controllers, and the parts that several share."""

import abc
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, PyTree

from diffdrive.errors import ParameterError
from diffdrive.model.memory import Memory
from diffdrive.model.parameters import Drive, Plant
from diffdrive.model.presets import PAPER_KD, PAPER_KP
from diffdrive.model.quantity import Directional, quantity, quantity_table
from diffdrive.numerics.arrays import Scalar
from diffdrive.observers.friction_observer import ObserverEstimate
from diffdrive.support.typing import TomlTable

if TYPE_CHECKING:
    from diffdrive.controllers.filters import Filter

Smoothed = TypeVar("Smoothed", bound="Controller")


class Reference(NamedTuple):
    """Where the table should be now (m), how fast (m/s), and how it should accelerate (m/s^2)."""

    position: Scalar
    velocity: Scalar
    acceleration: Scalar


class Encoders(NamedTuple):
    """What the encoders read: the scale (m), and that of the motor as table travel (m), None where there is none."""

    scale: Scalar
    motor: Scalar | None = None

    def at(self, name: str) -> Scalar:
        """The reading of one, "scale" or "motor"; raises `ParameterError` where the axis has no motor encoder."""
        if name == "scale":
            return self.scale
        if self.motor is None:
            raise ParameterError(
                "the controller feeds back the motor encoder, and the drive has no motor_encoder: give it one, or feed "
                "back the scale"
            )
        return self.motor


class Command(NamedTuple):
    """The force command (N), and the estimate behind it where the controller makes one."""

    force: Scalar
    estimate: ObserverEstimate | None = None


class Tunable(NamedTuple):
    """A gain that may be tuned: its dotted path in the controller, and the factor by which a search may move it.

    `enters_linearly` says that the command is linear in it, the other gains being what they are.
    """

    path: str
    factor: float
    enters_linearly: bool = False


class CommandPart(NamedTuple):
    """What a gain contributes to the command: what is lost where it is zero, the gains in `without` being zero, too."""

    gain: str
    without: tuple[str, ...] = ()


# margins limit the feedback gains long before these factors do; noise covariances are known to no better than 1e3
FEEDBACK_FACTOR, FILTER_FACTOR, CUTOFF_FACTOR = 30.0, 1e3, 10.0


class Controller(eqx.Module):
    """A controller as its interrupt routine sees it: once a period, from reference, scale and last force.

    One that uses the motor encoder says so in `feedback_encoders`, and has a `step_from_encoders` of its own.
    """

    @property
    def kind(self) -> str:
        """Its `kind` in the table [controller] of a drive file; "" if no file can state it."""
        return ""

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        """The gains that may be tuned, by name."""
        return {}

    @property
    def can_simulate(self) -> bool:
        """Whether its law is known, so that its command can be computed."""
        return True

    @property
    def is_memoryless(self) -> bool:
        """Whether its command depends on the last few samples alone: no integral, no observer that must settle."""
        return False

    @property
    def has_friction_observer(self) -> bool:
        """Whether it may estimate friction or load, so that what it assumed at first is forgotten only slowly.

        Without, its initial state soon leaves no more than a constant in the command.
        """
        return True

    @property
    def is_linear(self) -> bool:
        """Whether its command is linear in reference and position: no saturation, no friction that is fed forward."""
        return False

    @property
    def feedback_encoders(self) -> frozenset[str]:
        """The encoders that it uses: "scale", "motor" or both."""
        return frozenset({"scale"})

    @property
    def command_parts(self) -> tuple[CommandPart, ...]:
        """The parts of its command that other gains scale; by default one for each gain that it is linear in."""
        return tuple(CommandPart(name) for name, tunable in self.tunables.items() if tunable.enters_linearly)

    def table(self) -> TomlTable:
        """Its keys of [controller] in a drive file, without the kind."""
        raise ParameterError(f"no drive file can state a {type(self).__name__}: register a `Kind` of it")

    def with_filter(self, one: "Filter") -> "Controller":
        """The same controller with one more filter of its force command, behind those that it has.

        Raises `ParameterError` where it has none, as by default.
        """
        raise ParameterError(f"a {type(self).__name__} has no filters of its command; a cascade has")

    def with_model(self, drive: Drive) -> "Controller":
        """The same controller with this drive as its model of the machine."""
        return self

    def rate_problem(self, rate: float) -> str | None:
        """Why it cannot run at this control rate (Hz), such as a filter above half of it; None where it can."""
        return None

    @abc.abstractmethod
    def init(self, position: Scalar) -> PyTree:
        """State at rest, the table measured at `position` (m)."""

    def smoothed(self: Smoothed) -> Smoothed:
        """The smooth variant, for gradients: nothing that rounds or switches (`loop.smooth`). By default itself."""
        return self

    def moving(
        self,
        state: PyTree,
        position: Scalar,
        velocity: Scalar,
        bristle: Scalar | None = None,
        load: Scalar | None = None,
    ) -> PyTree:
        """The `state` at rest with all that is known of a steady motion: m, m/s, and if given m and N.

        An observer estimates these. Whatever else settles in a steady motion may stay as it is.
        """
        return state

    def following_error(self, velocity: Scalar, period: float) -> Scalar | None:
        """Reference minus measured position (m) in a steady motion (m/s), where its law alone decides it.

        By default None: it hangs on forces, or is not known.
        """
        return None

    def is_dynamic(self, state: PyTree) -> PyTree:
        """Which states take part in a small motion about a steady one: true or false, of `state` or each of its parts.

        A covariance does not, nor does what is only assumed. Counters and flags (no floating-point numbers) never do.
        """
        return True

    @abc.abstractmethod
    def step(
        self, state: PyTree, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[PyTree, Command]:
        """One period: measured `position` (m), and the force (N) that acted since the last one.

        Where the axis has two encoders, and both are used, this is the step on a stiff axis: both read `position`.
        """

    def step_from_encoders(
        self, state: PyTree, reference: Reference, encoders: Encoders, applied: Scalar, period: float
    ) -> tuple[PyTree, Command]:
        """`step`, from the encoders that it uses: by default the scale."""
        return self.step(state, reference, encoders.scale, applied, period)

    @property
    def pipelines(self) -> tuple[tuple[str, int], ...]:
        """Delay lines: the name of each, and its length in samples."""
        return ()


def require_rate(controller: Controller, rate: float) -> None:
    """Raise `ParameterError` where a controller cannot run at a control rate (Hz)."""
    problem = controller.rate_problem(rate)
    if problem is not None:
        raise ParameterError(f"controller.{problem}")


class Feedforward(eqx.Module):
    """Force for the reference's inertia and damping. A controller without feed-forward has None in its place."""

    mass: Scalar = quantity("kg", "mass in the acceleration feed-forward", at_least=0.0)
    damping: Directional = quantity(
        "N*s/m", "damping in the velocity feed-forward", at_least=0.0, per_direction=True, default=0.0
    )

    def force(self, reference: Reference) -> Scalar:
        """Feed-forward force (N)."""
        drag = self.damping.towards(reference.velocity) * reference.velocity
        return self.mass * reference.acceleration + drag

    @classmethod
    def of(cls, plant: Plant) -> "Feedforward":
        """The feed-forward that this plant needs."""
        return cls(mass=plant.mass, damping=plant.damping)


class PDGains(eqx.Module):
    """Position feedback kp e + kd (e[k] - e[k-1]) / T, with e[-1] = e[0]."""

    kp: Scalar = quantity("N/m", "proportional gain", at_least=0.0)
    kd: Scalar = quantity("N*s/m", "derivative gain, on the backward difference of the error", at_least=0.0)

    def force(self, error: Scalar, last_error: Scalar, period: float) -> Scalar:
        """Feedback force (N)."""
        return self.kp * error + self.kd * ((error - last_error) / period)


class LastError(NamedTuple):
    """The error one period ago (m), and whether there was one."""

    error: Annotated[Scalar, Memory("m", "position error one period ago")]
    known: Annotated[Bool[Array, ""], Memory("", "whether there was one")]

    @classmethod
    def none(cls) -> "LastError":
        """Before the first sample."""
        return cls(jnp.zeros(()), jnp.zeros((), bool))

    def value_or(self, error: Scalar) -> Scalar:
        """The last error, at the first sample this one."""
        return jnp.where(self.known, self.error, error)

    @staticmethod
    def after(error: Scalar) -> "LastError":
        """Remember this error."""
        return LastError(error, jnp.ones((), bool))


class Tracking(eqx.Module):
    """What every controller of the paper shares: the same feedback, and the same motion feed-forward."""

    gains: PDGains
    feedforward: Feedforward | None = None

    def step(self, last: LastError, reference: Reference, position: Scalar, period: float) -> tuple[LastError, Scalar]:
        """Feedback plus motion feed-forward (N)."""
        error = reference.position - position
        force = self.gains.force(error, last.value_or(error), period)
        if self.feedforward is not None:
            force = force + self.feedforward.force(reference)
        return LastError.after(error), force

    def table(self) -> TomlTable:
        """Its keys of [controller]."""
        return {"feedforward": self.feedforward is not None} | quantity_table(self.gains)

    def with_model(self, plant: Plant) -> "Tracking":
        """The same gains with the feed-forward of this plant, or still with none."""
        return self if self.feedforward is None else Tracking(self.gains, Feedforward.of(plant))


TRACKING_GAINS = {
    "kp": Tunable("tracking.gains.kp", FEEDBACK_FACTOR, enters_linearly=True),
    "kd": Tunable("tracking.gains.kd", FEEDBACK_FACTOR, enters_linearly=True),
}


def paper_tracking(drive: Drive, kp: Scalar = PAPER_KP, kd: Scalar = PAPER_KD) -> Tracking:
    """Feedback with these gains, by default the paper's, and the feed-forward of the drive's inertia and damping."""
    return Tracking(PDGains(kp, kd), Feedforward.of(drive.plant))
