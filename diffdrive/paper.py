"""The testbed of Lee et al. 2015 as an axis, under each of the paper's controllers and two of ours."""

from diffdrive.axis import Axis
from diffdrive.controllers import (
    DOBVSC,
    KINDS,
    PD,
    Cascade,
    Controller,
    DisturbanceObserver,
    FrictionCompensation,
    PDFeedforwardDOB,
)
from diffdrive.controllers.base import paper_tracking
from diffdrive.errors import ParameterError
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.model.presets import PAPER_FORCE_PER_VOLT, PAPER_KD, PAPER_KP, PAPER_STROKE, paper_drive
from diffdrive.motion.motion import Limits
from diffdrive.numerics.arrays import Scalar
from diffdrive.observers.friction_observer import KalmanObserver, LoadStateObserver, Tuning
from diffdrive.observers.load_estimator import InnovationLoad

SAMPLING = Sampling(rate=10_000.0)
LIMITS = Limits(stroke=(-PAPER_STROKE / 2, PAPER_STROKE / 2))


def paper_controllers(drive: Drive, kp: Scalar = PAPER_KP, kd: Scalar = PAPER_KD) -> dict[str, Controller]:
    """The paper's five controllers and two of ours, by their kind in a drive file; their model is exactly this drive.

    Ours are the friction observer with the load as a state (`pd+fc+ls`), and the cascade of most CNCs.
    """
    tracking = paper_tracking(drive, kp, kd)
    plant, friction = drive.plant, drive.friction
    return {
        "pd": PD(tracking),
        "dobvsc": DOBVSC(tracking, DisturbanceObserver.of(plant, 240.0)),
        "pd+ff+dob": PDFeedforwardDOB(tracking, DisturbanceObserver.of(plant, 3.0), friction),
        "pd+fc": FrictionCompensation(tracking, KalmanObserver(plant, friction)),
        "pd+fc+le": FrictionCompensation(tracking, KalmanObserver(plant, friction, Tuning(), InnovationLoad())),
        "pd+fc+ls": FrictionCompensation(tracking, LoadStateObserver(plant, friction)),
        "cascade": Cascade(kp=50.0, kv=1e5, ki=1e6, velocity_feedforward=1.0),
    }


def example_controllers(drive: Drive) -> dict[str, Controller]:
    """A controller of every kind that has gains for the paper's testbed, by its kind."""
    others = {name: kind.example(drive) for name, kind in KINDS.items() if kind.example is not None}
    return paper_controllers(drive) | others


def paper_axis(controller: str = "pd", *, quantised: bool = True) -> Axis:
    """The paper's testbed: 100 kg on linear guides, 0.1 um scale, 150 mm of stroke, 10 kHz.

    Source: Lee et al. 2015, Tables 2 and 3; docs/evidence/paper.md.

    Args:
        controller: Its kind: `pd`, `dobvsc`, `pd+ff+dob`, `pd+fc`, `pd+fc+le` (the paper's), `pd+fc+ls` (whose load
            estimator converges at every speed), `cascade`, or another that says which gains suit this machine.
        quantised: Whether the scale has steps (0.1 um).

    Raises:
        ParameterError: No controller of this kind is known.

    Examples:
        >>> paper_axis("pd+fc+ls")
        Axis(100 kg, pd+fc+ls, 10000 Hz)

    """
    drive = paper_drive(quantised=quantised)
    controllers = example_controllers(drive)
    if controller not in controllers:
        raise ParameterError(f"controller: no kind {controller!r}; known: {', '.join(controllers)}")
    return Axis(
        drive, controllers[controller], SAMPLING, LIMITS, ColumnMapping(force_per_volt=PAPER_FORCE_PER_VOLT), "paper"
    )
