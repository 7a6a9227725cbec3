"""The [controller] table of a drive file: which controller, with which gains."""

import dataclasses
from functools import partial
from typing import Any

from diffdrive.controllers import (
    DOBVSC,
    PD,
    Cascade,
    Controller,
    DisturbanceObserver,
    Feedforward,
    FrictionCompensation,
    PDFeedforwardDOB,
    PDGains,
    Tracking,
    UnknownController,
)
from diffdrive.model.parameters import Drive, quantity_table
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, LoadStateTuning, Tuning
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad
from diffdrive.support.messages import shown

KINDS = {
    "pd": "feedback and motion feed-forward",
    "dobvsc": "disturbance observer with variable-structure control",
    "pd+ff+dob": "friction fed forward from the reference, disturbance observer on the rest",
    "pd+fc": "friction observer",
    "pd+fc+le": "friction observer with the load estimator of the paper's eq. (20)",
    "pd+fc+ls": "friction observer with the load as a state, which converges at every speed",
    "cascade": "proportional position loop over a PI velocity loop",
    "unknown": "for identification and diagnosis, from the logged command",
}

# controllers of the paper carry the inertia and damping feed-forward unless told otherwise; a bare PD or cascade is
# what most machines run, and has none
_FEEDFORWARD = {"pd": False, "cascade": False}

_OBSERVED = ("pd+fc", "pd+fc+le", "pd+fc+ls")
_OF_THE_PAPER = tuple(kind for kind in KINDS if kind not in ("cascade", "unknown"))
# which kinds have which keys: said of one that is left in a file whose kind was changed
_PARTS: dict[str, dict[Any, tuple[str, ...]]] = {
    "controller": {
        PDGains: _OF_THE_PAPER,
        DisturbanceObserver: ("dobvsc", "pd+ff+dob"),
        DOBVSC: ("dobvsc",),
        PDFeedforwardDOB: ("pd+ff+dob",),
        Cascade: ("cascade",),
    },
    "controller.observer": {Tuning: ("pd+fc", "pd+fc+le"), LoadStateTuning: ("pd+fc+ls",)},
    "controller.load_estimator": dict(zip((FixedLoad, InnovationLoad, LoadStateObserver), zip(_OBSERVED), strict=True)),
}
_FROM_THE_PLANT = {"mass", "damping"}  # what a disturbance observer believes of the machine is no key of its own
_BESIDE = {
    "feedforward": (*_OF_THE_PAPER, "cascade"),
    "derivative": _OF_THE_PAPER,
    "velocity_samples": ("cascade",),
    "observer": _OBSERVED,
    "load_estimator": _OBSERVED,
}


def _kinds_with(table: str, key: str) -> list[str]:
    """The kinds of controller whose `table` may hold `key`."""
    found = {*(_BESIDE.get(key, ()) if table == "controller" else ())}
    for part, kinds in _PARTS[table].items():
        declared = {field.name for field in dataclasses.fields(part) if "quantity" in field.metadata}
        if key in declared - _FROM_THE_PLANT:
            found.update(kinds)
    return [kind for kind in KINDS if kind in found]


def _of_kind(section: Any, kind: str) -> Any:
    """The section, which knows from now on which other kinds have a key that is left in it."""
    section.kind, section.kinds_with = kind, partial(_kinds_with, section.name)
    return section


def build_controller(section: Any, drive: Drive) -> Controller:
    """The controller that a `drive_file.Section` describes, its model being the file's own plant and friction."""
    kind = section.take("kind", None)
    if kind is None:
        raise section.fail("kind", f"is missing; known: {', '.join(KINDS)}")
    if not isinstance(kind, str) or kind not in KINDS:
        raise section.fail("kind", f"unknown controller {shown(kind)}; known: {', '.join(KINDS)}")
    _of_kind(section, kind)
    if kind == "unknown":
        return UnknownController()
    wanted = section.take("feedforward", _FEEDFORWARD.get(kind, True))
    if not isinstance(wanted, bool):
        raise section.fail("feedforward", f"must be true or false, got {shown(wanted)}")
    feedforward = Feedforward.of(drive.plant) if wanted else Feedforward()
    if kind == "cascade":
        samples = section.take("velocity_samples", 1)
        if isinstance(samples, bool) or not isinstance(samples, int) or samples < 1:
            raise section.fail("velocity_samples", f"must be a whole number of at least 1, got {shown(samples)}")
        return section.build(Cascade, feedforward=feedforward, velocity_samples=samples)
    derivative = section.take("derivative", "backward-difference")
    if derivative != "backward-difference":
        raise section.fail("derivative", f"only 'backward-difference' is known, got {shown(derivative)}")
    tracking = Tracking(section.build(PDGains), feedforward)
    return _compensation(kind, section, drive, tracking)


def _compensation(kind: str, section: Any, drive: Drive, tracking: Tracking) -> Controller:
    plant, friction = drive.plant, drive.friction
    if kind == "pd":
        return PD(tracking)
    if kind in ("dobvsc", "pd+ff+dob"):
        observer = section.build(DisturbanceObserver, mass=plant.mass, damping=plant.damping)
        if kind == "dobvsc":
            return section.build(DOBVSC, tracking=tracking, observer=observer)
        return section.build(PDFeedforwardDOB, tracking=tracking, observer=observer, friction=friction)
    tuning, estimator = (_of_kind(section.subsection(key), kind) for key in ("observer", "load_estimator"))
    if kind == "pd+fc+ls":
        observer = estimator.build(
            LoadStateObserver, plant=plant, friction=friction, tuning=tuning.build(LoadStateTuning)
        )
    else:
        load = estimator.build(InnovationLoad if kind == "pd+fc+le" else FixedLoad)
        observer = KalmanObserver(plant, friction, tuning.build(Tuning), load)
    tuning.done()
    estimator.done()
    return FrictionCompensation(tracking, observer)


def controller_table(controller: Controller) -> dict[str, Any]:
    """The [controller] table that describes this controller."""
    if isinstance(controller, UnknownController):
        return {"kind": "unknown"}
    if isinstance(controller, Cascade):
        fed = float(controller.feedforward.mass) > 0
        return {
            "kind": "cascade",
            "feedforward": fed,
            "velocity_samples": controller.velocity_samples,
        } | quantity_table(controller)
    tracking = controller.tracking  # type: ignore[attr-defined]
    table: dict[str, Any] = {"feedforward": float(tracking.feedforward.mass) > 0} | quantity_table(tracking.gains)
    if isinstance(controller, PD):
        return {"kind": "pd"} | table
    if isinstance(controller, DOBVSC | PDFeedforwardDOB):
        kind = "dobvsc" if isinstance(controller, DOBVSC) else "pd+ff+dob"
        return {"kind": kind, "cutoff": float(controller.observer.cutoff)} | table | quantity_table(controller)
    if not isinstance(controller, FrictionCompensation):
        raise TypeError(f"no drive-file form is known for {type(controller).__name__}")
    observer = controller.observer
    if isinstance(observer, LoadStateObserver):
        kind, estimator = "pd+fc+ls", observer
    else:
        assert isinstance(observer, KalmanObserver)
        estimator = observer.load_estimator
        kind = "pd+fc+le" if isinstance(estimator, InnovationLoad) else "pd+fc"
    below = {"observer": quantity_table(observer.tuning), "load_estimator": quantity_table(estimator)}
    return {"kind": kind} | table | below
