"""The drive file's controller put to the logged reference and position: the command that it should have given."""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax import lax

from diffdrive import actuator
from diffdrive.controllers import PD, Cascade, Controller, Reference
from diffdrive.drive_file import DriveDescription
from diffdrive.logs.log import Signal
from diffdrive.parameters import Drive, as_arrays, require_double_precision

SETTLE = 10  # samples until differences over the controller's past are those of the log


@eqx.filter_jit
def _outputs(controller: Controller, drive: Drive, references: Reference, positions: Any, period: float) -> Any:
    def one(reference: Reference, position: Any) -> Any:
        def body(carry: Any, at: Any) -> Any:
            state, acting = carry
            # the observer is fed what this controller asks for, so that a wrong unit of the log does not reach it
            state, command = controller.step(state, at[0], at[1], acting.applied, period)
            return (state, actuator.step(drive.actuator, acting, command.force)), command.force

        begin = (controller.init(position[0]), actuator.init(drive.actuator))
        return lax.scan(body, begin, (reference, position))[1]

    return jax.vmap(one)(references, positions)


def outputs(description: DriveDescription, references: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Commands (N) [m, n] of the controller for m pairs of reference and position (m) [m, n].

    The reference's velocity and acceleration, which the log does not hold, are its central differences.
    """
    require_double_precision()
    period = 1.0 / description.sampling.rate
    count = references.shape[1]
    # the length is rounded up, at rest at the end, so that logs of similar length share one compiled program
    width = 4096 * -(-count // 4096)
    pad = ((0, 0), (0, width - count))
    speed = np.gradient(references, period, axis=1)
    reference = Reference(
        np.pad(references, pad, mode="edge"),
        np.pad(speed, pad),
        np.pad(np.gradient(speed, period, axis=1), pad),
    )
    positions = np.pad(positions, pad, mode="edge")
    controller, drive = as_arrays((description.controller, description.drive))
    return np.asarray(_outputs(controller, drive, as_arrays(reference), as_arrays(positions), period))[:, :count]


def shifted(signal: Signal, samples: int) -> Signal:
    """The signal some samples later (negative: earlier), its end values repeated."""
    if samples == 0:
        return signal
    if samples > 0:
        return np.concatenate([np.full(samples, signal[0]), signal[:-samples]])
    return np.concatenate([signal[-samples:], np.full(-samples, signal[-1])])


def remembers_nothing(controller: Controller) -> bool:
    """Whether its output rests on the last samples alone: no integral and no observer to settle first."""
    return isinstance(controller, PD) or (isinstance(controller, Cascade) and float(controller.ki) == 0)
