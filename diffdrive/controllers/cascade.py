"""The cascade of most CNCs and servo amplifiers: proportional position loop, PI velocity loop inside it."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import PyTree

from diffdrive.controllers.base import (
    FEEDBACK_FACTOR,
    Command,
    CommandPart,
    Controller,
    Encoders,
    Feedforward,
    Reference,
    Tunable,
)
from diffdrive.controllers.feedback import FEEDBACK, FEEDBACK_OPTIONS, feedback_problem, read_feedback
from diffdrive.controllers.kinds import FEEDFORWARD, Keys, Kind, Option, Section, read_feedforward
from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantity, quantity_table
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.pipeline import Pipeline, filled, pushed
from diffdrive.support.messages import short_repr
from diffdrive.support.typing import TomlTable


class CascadeState(NamedTuple):
    """Past positions and the velocity loop's integral."""

    past: Pipeline  # measured positions of which the velocity is made, oldest first
    integral: Scalar  # N
    started: Scalar


class Cascade(Controller):
    """u = kv (kp e + ff v_ref - v) + ki int(kp e + ff v_ref - v) + motion feed-forward.

    The velocity is the backward difference over `velocity_samples` samples, (y[k] - y[k-n]) / (n T). Each loop uses the
    scale or the motor encoder.
    """

    kp: Scalar = quantity("1/s", "Kv factor of the position loop", at_least=0.0)
    kv: Scalar = quantity("N*s/m", "velocity gain, not the Kv factor", at_least=0.0)
    ki: Scalar = quantity("N/m", "integral gain of the velocity loop", at_least=0.0, default=0.0)
    velocity_feedforward: Scalar = quantity(
        "1", "share of the reference velocity fed forward", at_least=0.0, default=0.0
    )
    feedforward: Feedforward | None = None
    velocity_samples: int = eqx.field(static=True, default=1)
    position_feedback: str = eqx.field(static=True, default="scale")
    velocity_feedback: str = eqx.field(static=True, default="scale")

    def __check_init__(self) -> None:
        problem = _samples_problem(self.velocity_samples)
        if problem is not None:
            raise ParameterError(f"velocity_samples {problem}")
        for name in FEEDBACK:
            problem = feedback_problem(getattr(self, name))
            if problem is not None:
                raise ParameterError(f"{name} {problem}")

    @property
    def kind(self) -> str:
        return "cascade"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        return {name: Tunable(name, FEEDBACK_FACTOR, enters_linearly=True) for name in ("kp", "kv", "ki")}

    @property
    def has_friction_observer(self) -> bool:
        return False

    @property
    def is_linear(self) -> bool:
        return True

    @property
    def is_memoryless(self) -> bool:
        return float(self.ki) == 0

    @property
    def feedback_encoders(self) -> frozenset[str]:
        return frozenset({self.position_feedback, self.velocity_feedback})

    @property
    def command_parts(self) -> tuple[CommandPart, ...]:
        if self.is_memoryless:
            return CommandPart("kp"), CommandPart("kv")
        # the gains of both loops are multiplied with one another
        return CommandPart("kp"), CommandPart("ki"), CommandPart("kv", without=("kp", "ki"))

    def table(self) -> TomlTable:
        options = {"feedforward": self.feedforward is not None, "velocity_samples": self.velocity_samples}
        feedback = {name: getattr(self, name) for name in FEEDBACK} if "motor" in self.feedback_encoders else {}
        return options | feedback | quantity_table(self)

    def with_model(self, drive: Drive) -> "Cascade":
        return self if self.feedforward is None else replace(self, feedforward=Feedforward.of(drive.plant))

    @property
    def pipelines(self) -> tuple[tuple[str, int], ...]:
        """The positions that the velocity is computed from."""
        return (("controller.velocity_samples", self.velocity_samples),)

    def init(self, position: Scalar) -> CascadeState:
        zero = jnp.zeros_like(position)
        return CascadeState(filled(position, self.velocity_samples), zero, zero)

    def following_error(self, velocity: Scalar, period: float) -> Scalar | None:
        # with an integral, or without any force, the velocity loop is at its set-point: kp e + ff v = v
        moves = self.kp > 0
        return jnp.where(moves, (1.0 - self.velocity_feedforward) * velocity / jnp.where(moves, self.kp, 1.0), 0.0)

    def is_dynamic(self, state: CascadeState) -> PyTree:
        return jax.tree.map(lambda _: True, state)._replace(started=False)

    def step(
        self, state: CascadeState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[CascadeState, Command]:
        return self.step_from_encoders(state, reference, Encoders(position, position), applied, period)

    def step_from_encoders(
        self, state: CascadeState, reference: Reference, encoders: Encoders, applied: Scalar, period: float
    ) -> tuple[CascadeState, Command]:
        position, differenced = encoders.at(self.position_feedback), encoders.at(self.velocity_feedback)
        # before the first sample the table stood where it is first measured
        history = jax.tree.map(lambda p: state.started * p + (1.0 - state.started) * differenced, state.past)
        oldest_position, history = pushed(history, differenced)
        velocity = (differenced - oldest_position) / (self.velocity_samples * period)
        velocity_reference = self.kp * (reference.position - position) + self.velocity_feedforward * reference.velocity
        integral = state.integral + self.ki * period * (velocity_reference - velocity)
        force = self.kv * (velocity_reference - velocity) + integral
        if self.feedforward is not None:
            force = force + self.feedforward.force(reference)
        return CascadeState(history, integral, jnp.ones_like(position)), Command(force)


def _samples_problem(samples: object) -> str | None:
    """Why a velocity cannot be differenced over so many samples; None where it can."""
    if isinstance(samples, bool) or not isinstance(samples, int) or samples < 1:
        return f"must be a whole number of at least 1, got {short_repr(samples)}"
    return None


VELOCITY_SAMPLES = Option("velocity_samples", "-", ">= 1, whole", "1", "samples over which the velocity is differenced")


def _build(section: Section, drive: Drive) -> Cascade:
    # the loop of most CNCs has no feed-forward of force unless the file says so
    feedforward, samples = read_feedforward(section, drive, default=False), section.take("velocity_samples", 1)
    problem = _samples_problem(samples)
    if problem is not None:
        raise section.fail("velocity_samples", problem)
    return section.build(Cascade, feedforward=feedforward, velocity_samples=samples, **read_feedback(section, drive))


KIND = Kind(
    "cascade",
    "proportional position loop over a PI velocity loop",
    _build,
    (Keys("controller", Cascade),),
    (FEEDFORWARD, VELOCITY_SAMPLES, *FEEDBACK_OPTIONS),
    example=lambda drive: Cascade(kp=50.0, kv=1e5, ki=1e6, velocity_feedforward=1.0),
)
