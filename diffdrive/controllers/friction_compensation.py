"""PD+FC and PD+FC+LE: the friction observer's estimate added to the command."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import NamedTuple

import equinox as eqx
import jax
from jaxtyping import PyTree

from diffdrive.controllers.base import (
    FILTER_FACTOR,
    TRACKING_GAINS,
    Command,
    Controller,
    LastError,
    Reference,
    Tracking,
    Tunable,
    paper_tracking,
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
from diffdrive.numerics.arrays import Scalar
from diffdrive.observers.friction_observer import (
    FrictionObserver,
    KalmanObserver,
    LoadStateObserver,
    LoadStateTuning,
    Tuning,
)
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad
from diffdrive.support.typing import TomlTable


class FrictionCompensationState(NamedTuple):
    """Last error and the observer's state."""

    last_error: LastError
    observer: PyTree


class FrictionCompensation(Controller):
    """u = PD + feed-forward + Fhat (paper, Fig. 6(d) and (e)).

    The observer decides which of the paper's controllers this is: `KalmanObserver` with `FixedLoad` is PD+FC, with
    `InnovationLoad` PD+FC+LE as printed; `LoadStateObserver` estimates the load at every speed.
    """

    tracking: Tracking
    observer: FrictionObserver

    @property
    def kind(self) -> str:
        return f"pd+fc{self.observer.suffix}"

    @property
    def tunables(self) -> Mapping[str, Tunable]:
        observer_gains = {
            name: Tunable(f"observer.{path}", FILTER_FACTOR) for name, path in self.observer.gains.items()
        }
        return TRACKING_GAINS | observer_gains

    def table(self) -> TomlTable:
        return self.tracking.table() | self.observer.tables()

    def with_model(self, drive: Drive) -> "FrictionCompensation":
        observer = replace(self.observer, plant=drive.plant, friction=drive.friction)
        return FrictionCompensation(self.tracking.with_model(drive.plant), observer)

    def init(self, position: Scalar) -> FrictionCompensationState:
        return FrictionCompensationState(LastError.none(), self.observer.init(position))

    def moving(
        self,
        state: FrictionCompensationState,
        position: Scalar,
        velocity: Scalar,
        bristle: Scalar | None = None,
        load: Scalar | None = None,
    ) -> FrictionCompensationState:
        return state._replace(observer=self.observer.moving(state.observer, position, velocity, bristle, load))

    def is_dynamic(self, state: FrictionCompensationState) -> PyTree:
        return jax.tree.map(lambda _: True, state)._replace(observer=self.observer.is_dynamic(state.observer))

    def step(
        self, state: FrictionCompensationState, reference: Reference, position: Scalar, applied: Scalar, period: float
    ) -> tuple[FrictionCompensationState, Command]:
        observer_state, estimate = self.observer.step(state.observer, applied, position, period)
        last_error, force = self.tracking.step(state.last_error, reference, position, period)
        return FrictionCompensationState(last_error, observer_state), Command(force + estimate.friction, estimate)


def _builder_with(
    load: type[FixedLoad] | type[InnovationLoad],
) -> Callable[[Section, Drive], FrictionCompensation]:
    """How a friction observer with this load estimator is built."""

    def build(section: Section, drive: Drive) -> FrictionCompensation:
        tracking = read_tracking(section, drive)
        tuning, estimator = section.subsection("observer"), section.subsection("load_estimator")
        observer = KalmanObserver(drive.plant, drive.friction, tuning.build(Tuning), estimator.build(load))
        return FrictionCompensation(tracking, observer)

    return build


def _build_with_load_state(section: Section, drive: Drive) -> FrictionCompensation:
    tracking = read_tracking(section, drive)
    tuning, estimator = section.subsection("observer"), section.subsection("load_estimator")
    observer = estimator.build(
        LoadStateObserver, plant=drive.plant, friction=drive.friction, tuning=tuning.build(LoadStateTuning)
    )
    return FrictionCompensation(tracking, observer)


def _keys(tuning: type[eqx.Module], estimator: type[eqx.Module]) -> tuple[Keys, ...]:
    return (TRACKING_KEYS, Keys("controller.observer", tuning), Keys("controller.load_estimator", estimator))


def _example(observer: type[FrictionObserver], *settings: eqx.Module) -> Callable[[Drive], FrictionCompensation]:
    return lambda drive: FrictionCompensation(paper_tracking(drive), observer(drive.plant, drive.friction, *settings))


KINDS = (
    Kind(
        "pd+fc",
        "friction observer",
        _builder_with(FixedLoad),
        _keys(Tuning, FixedLoad),
        TRACKING_OPTIONS,
        example=_example(KalmanObserver),
    ),
    Kind(
        "pd+fc+le",
        "friction observer with the load estimator of the paper's eq. (20)",
        _builder_with(InnovationLoad),
        _keys(Tuning, InnovationLoad),
        TRACKING_OPTIONS,
        example=_example(KalmanObserver, Tuning(), InnovationLoad()),
    ),
    Kind(
        "pd+fc+ls",
        "friction observer with the load as a state, which converges at every speed",
        _build_with_load_state,
        _keys(LoadStateTuning, LoadStateObserver),
        TRACKING_OPTIONS,
        example=_example(LoadStateObserver),
    ),
)
