"""The drive file's controller put to the logged reference and position: the command that it should have given."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from diffdrive.axis import Axis
from diffdrive.controllers import PD, Cascade, Controller, FrictionCompensation, Reference
from diffdrive.model import actuator
from diffdrive.model.friction import lugre_coefficients
from diffdrive.model.parameters import Drive, as_arrays, require_double_precision

WIDTHS = (4096, 65_536)  # samples; of what has more than ten times as many the next
SETTLE = 10  # samples until differences over the controller's past are those of the log


@eqx.filter_jit
def _controller_commands(
    controller: Controller, drive: Drive, references: Reference, positions: Any, speed: Any, given: Any, period: Any
) -> Any:
    def one(reference: Reference, position: Any) -> Any:
        def body(carry: Any, at: Any) -> Any:
            state, acting = carry
            state, command = controller.step(state, at[0], at[1], acting.applied, period)
            # without the log's command, what this controller asks for itself: a wrong unit does not reach its observer
            acted = command.force if given is None else at[2]
            return (state, actuator.step(drive.actuator, acting, acted)), command.force

        begin = (_initial_state(controller, position[0], speed), actuator.init(drive.actuator))
        return lax.scan(body, begin, (reference, position, given))[1]

    return jax.vmap(one)(references, positions)


def _initial_state(controller: Controller, position: Any, speed: Any) -> Any:
    """The controller's state at a speed (m/s). An observer begun at rest would take the motion for a blow."""
    state = controller.init(position)
    if not isinstance(controller, FrictionCompensation):
        return state
    observed = state.observer
    bristle = lugre_coefficients(controller.observer.friction, speed, speed, observed.load)
    sliding = jnp.sign(speed) * bristle.level / bristle.stiffness
    return state._replace(observer=observed._replace(x=(position, speed, sliding)))


ControllerAndDrive = tuple[Controller, Drive]


def controller_arrays(description: Axis) -> ControllerAndDrive:
    """The controller and the drive whose actuator it knows, as arrays."""
    require_double_precision()
    return as_arrays((description.controller, description.drive))


def controller_commands(
    software: ControllerAndDrive,
    references: np.ndarray,
    positions: np.ndarray,
    period: float,
    speed: float = 0.0,
    given: np.ndarray | None = None,
) -> np.ndarray:
    """Commands (N) [m, n] of the controller for m pairs of reference and position (m) [m, n], `period` (s) apart.

    It begins at `speed` (m/s). Its observer is fed what it asks for itself, or the command `given` (N) [n], as on the
    machine: then it forgets how it began. The reference's velocity and acceleration, which the log does not hold, are
    its central differences.
    """
    count = references.shape[1]
    # the length is rounded up, at rest at the end, so that logs of similar length share one compiled program
    block = next((size for size in WIDTHS if count <= 10 * size), WIDTHS[-1])
    width = block * -(-count // block)
    pad = ((0, 0), (0, width - count))
    rates = np.gradient(references, period, axis=1)
    reference = Reference(
        np.pad(references, pad, mode="edge"),
        np.pad(rates, pad),
        np.pad(np.gradient(rates, period, axis=1), pad),
    )
    positions = np.pad(positions, pad, mode="edge")
    given = None if given is None else np.pad(given, (0, width - count), mode="edge")
    signals = as_arrays((reference, positions, np.asarray(speed), given, np.asarray(period)))
    return np.asarray(_controller_commands(*software, *signals))[:, :count]


def is_memoryless(controller: Controller) -> bool:
    """Whether its output rests on the last samples alone: no integral and no observer to settle first."""
    return isinstance(controller, PD) or (isinstance(controller, Cascade) and float(controller.ki) == 0)


def is_linear(controller: Controller) -> bool:
    """Whether what it began with soon leaves no more than a constant: it has no friction observer, nor a load's."""
    return not isinstance(controller, FrictionCompensation)
