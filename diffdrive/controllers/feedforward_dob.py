"""PD+FF+DOB: friction predicted from the reference, the rest left to a disturbance observer."""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import jax.numpy as jnp

from diffdrive.controllers.base import (
    CUTOFF_FACTOR,
    TRACKING_GAINS,
    Command,
    Controller,
    LastError,
    Reference,
    Tracking,
    Tunable,
    paper_tracking,
)
from diffdrive.controllers.disturbance_observer import (
    OBSERVER_KEYS,
    DisturbanceObserver,
    DisturbanceState,
    read_observer,
)
from diffdrive.controllers.kinds import (
    TRACKING_KEYS,
    TRACKING_OPTIONS,
    Keys,
    Kind,
    Section,
    read_tracking,
)
from diffdrive.model.friction import deflection_after, friction_force, lugre_coefficients
from diffdrive.model.memory import Memory
from diffdrive.model.parameters import Drive, Friction
from diffdrive.model.quantity import quantity, quantity_table
from diffdrive.numerics.arrays import Scalar
from diffdrive.observers.friction_observer import ObserverEstimate
from diffdrive.support.typing import TomlTable


class FeedforwardState(NamedTuple):
    """Last error, bristle of the fed-forward friction (m), its force last time (N), disturbance observer."""

    last_error: LastError
    bristle: Annotated[Scalar, Memory("m", "bristle deflection of the friction that is fed forward")]
    last_feedforward: Annotated[Scalar, Memory("N", "friction that was fed forward one period ago")]
    disturbance: DisturbanceState


class PDFeedforwardDOB(Controller):
    """PD + LuGre friction driven by the reference velocity + DOB on the remainder (paper, Fig. 6(c))."""

    tracking: Tracking
    observer: DisturbanceObserver
    friction: Friction
    load: Scalar = quantity("N", "applied load that the feed-forward assumes", default=0.0)

    @property
    def kind(self) -> str:
        return "pd+ff+dob"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        return TRACKING_GAINS | {"cutoff": Tunable("observer.cutoff", CUTOFF_FACTOR)}

    @property
    def has_friction_observer(self) -> bool:
        return False

    def table(self) -> TomlTable:
        return {"cutoff": float(self.observer.cutoff)} | self.tracking.table() | quantity_table(self)

    def with_model(self, drive: Drive) -> "PDFeedforwardDOB":
        tracking, observer = self.tracking.with_model(drive.plant), self.observer.with_model(drive.plant)
        return PDFeedforwardDOB(tracking, observer, drive.friction, self.load)

    def init(self, position: Scalar) -> FeedforwardState:
        zero = jnp.zeros_like(position)
        return FeedforwardState(LastError.none(), zero, zero, self.observer.init(position))

    def step(
        self, state: FeedforwardState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[FeedforwardState, Command]:
        coefficients = lugre_coefficients(self.friction, reference.velocity, state.bristle, self.load)
        deflection = deflection_after(state.bristle, reference.velocity, coefficients.rate, period)
        predicted = friction_force(coefficients, reference.velocity, deflection)
        unexplained = applied - state.last_feedforward
        observer_state, disturbance = self.observer.step(state.disturbance, position, unexplained, period)
        last_error, force = self.tracking.step(state.last_error, reference, position, period)
        estimate = ObserverEstimate(predicted + disturbance)
        state = FeedforwardState(last_error, deflection, predicted, observer_state)
        return state, Command(force + predicted + disturbance, estimate)


def _build(section: Section, drive: Drive) -> PDFeedforwardDOB:
    tracking, observer = read_tracking(section, drive), read_observer(section, drive)
    return section.build(PDFeedforwardDOB, tracking=tracking, observer=observer, friction=drive.friction)


KIND = Kind(
    "pd+ff+dob",
    "friction fed forward from the reference, disturbance observer on the rest",
    _build,
    (TRACKING_KEYS, OBSERVER_KEYS, Keys("controller", PDFeedforwardDOB)),
    TRACKING_OPTIONS,
    example=lambda drive: PDFeedforwardDOB(
        paper_tracking(drive), DisturbanceObserver.of(drive.plant, 3.0), drive.friction
    ),
)
