"""DOBVSC: disturbance observer plus variable-structure (sliding-mode) control."""

from collections.abc import Mapping
from typing import NamedTuple

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
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantity, quantity_table
from diffdrive.numerics.arrays import Scalar
from diffdrive.observers.friction_observer import ObserverEstimate
from diffdrive.support.typing import TomlTable

SURFACE_FACTOR = 10.0  # by which a search may move what shapes the sliding surface


class DOBVSCState(NamedTuple):
    """Last error and disturbance observer."""

    last_error: LastError
    disturbance: DisturbanceState


class DOBVSC(Controller):
    """PD + DOB + eta sat(s / phi), s = de/dt + slope e (paper, Fig. 6(b), after Lin et al. 2013).

    The paper gives neither the law's form nor its gains; this form and the defaults are ours (docs/evidence/paper.md).
    """

    tracking: Tracking
    observer: DisturbanceObserver
    reach: Scalar = quantity("N", "switching force eta", at_least=0.0, default=1.0)
    layer: Scalar = quantity("m/s", "boundary layer phi", above=0.0, default=1e-3)
    slope: Scalar = quantity("1/s", "slope of the sliding surface", at_least=0.0, default=300.0)

    @property
    def kind(self) -> str:
        return "dobvsc"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        surface_gains = {name: Tunable(name, SURFACE_FACTOR) for name in ("reach", "layer", "slope")}
        return TRACKING_GAINS | {"cutoff": Tunable("observer.cutoff", CUTOFF_FACTOR)} | surface_gains

    @property
    def has_friction_observer(self) -> bool:
        return False

    def table(self) -> TomlTable:
        return {"cutoff": float(self.observer.cutoff)} | self.tracking.table() | quantity_table(self)

    def with_model(self, drive: Drive) -> "DOBVSC":
        tracking, observer = self.tracking.with_model(drive.plant), self.observer.with_model(drive.plant)
        return DOBVSC(tracking, observer, self.reach, self.layer, self.slope)

    def init(self, position: Scalar) -> DOBVSCState:
        return DOBVSCState(LastError.none(), self.observer.init(position))

    def step(
        self, state: DOBVSCState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[DOBVSCState, Command]:
        error = reference.position - position
        surface = (error - state.last_error.value_or(error)) / period + self.slope * error
        switching = self.reach * jnp.clip(surface / self.layer, -1.0, 1.0)
        last_error, force = self.tracking.step(state.last_error, reference, position, period)
        observer_state, disturbance = self.observer.step(state.disturbance, position, applied, period)
        estimate = ObserverEstimate(disturbance)
        return DOBVSCState(last_error, observer_state), Command(force + switching + disturbance, estimate)


def _build(section: Section, drive: Drive) -> DOBVSC:
    tracking = read_tracking(section, drive)
    return section.build(DOBVSC, tracking=tracking, observer=read_observer(section, drive))


KIND = Kind(
    "dobvsc",
    "disturbance observer with variable-structure control",
    _build,
    (TRACKING_KEYS, OBSERVER_KEYS, Keys("controller", DOBVSC)),
    TRACKING_OPTIONS,
    example=lambda drive: DOBVSC(paper_tracking(drive), DisturbanceObserver.of(drive.plant, 240.0)),
)
