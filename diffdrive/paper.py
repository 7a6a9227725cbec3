"""The testbed of Lee et al. 2015 as an axis, under each of the paper's controllers and two of ours."""

from diffdrive.axis import Axis
from diffdrive.controllers import KINDS, Controller
from diffdrive.errors import ParameterError
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.model.presets import PAPER_FORCE_PER_VOLT, PAPER_STROKE, paper_drive
from diffdrive.motion.motion import Limits

SAMPLING = Sampling(rate=10_000.0)
LIMITS = Limits(stroke=(-PAPER_STROKE / 2, PAPER_STROKE / 2))


def example_controllers(drive: Drive) -> dict[str, Controller]:
    """A controller of every kind that has gains for the paper's testbed, by its kind; its model is exactly this drive.

    The paper's five, and ours: the friction observer with the load as a state (`pd+fc+ls`), the cascade of most CNCs,
    and what programs register with an `example`.
    """
    return {name: kind.example(drive) for name, kind in KINDS.items() if kind.example is not None}


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
