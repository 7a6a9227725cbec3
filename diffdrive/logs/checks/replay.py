"""The drive file's controller replayed on the logged reference and position: the command that it should have given."""

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
SETTLE = 10  # samples until the controller's differences are those of the log


@eqx.filter_jit
def _controller_commands(
    controller: Controller,
    drive: Drive,
    references: Reference,
    positions: Any,
    speed: Any,
    logged_commands: Any,
    period: Any,
) -> Any:
    def replay(reference: Reference, position: Any) -> Any:
        def body(carry: Any, inputs: Any) -> Any:
            state, actuator_state = carry
            state, command = controller.step(state, inputs[0], inputs[1], actuator_state.applied, period)
            # without the log's command, the controller's own: a wrong unit does not reach its observer
            force = command.force if logged_commands is None else inputs[2]
            return (state, actuator.step(drive.actuator, actuator_state, force)), command.force

        initial = (_initial_state(controller, position[0], speed), actuator.init(drive.actuator))
        return lax.scan(body, initial, (reference, position, logged_commands))[1]

    return jax.vmap(replay)(references, positions)


def _initial_state(controller: Controller, position: Any, speed: Any) -> Any:
    """The controller's state at a speed (m/s). An observer that begins at rest would take the motion for a shock."""
    state = controller.init(position)
    if not isinstance(controller, FrictionCompensation):
        return state
    observed = state.observer
    bristle = lugre_coefficients(controller.observer.friction, speed, speed, observed.load)
    sliding = jnp.sign(speed) * bristle.level / bristle.stiffness
    return state._replace(observer=observed._replace(x=(position, speed, sliding)))


ControllerAndDrive = tuple[Controller, Drive]


def controller_arrays(axis: Axis) -> ControllerAndDrive:
    """The axis's controller and drive, as arrays."""
    require_double_precision()
    return as_arrays((axis.controller, axis.drive))


def controller_commands(
    arrays: ControllerAndDrive,
    references: np.ndarray,
    positions: np.ndarray,
    period: float,
    speed: float = 0.0,
    logged_command: np.ndarray | None = None,
) -> np.ndarray:
    """Commands (N) [m, n] of the controller for m pairs of reference and position (m) [m, n], `period` (s) apart.

    It begins at `speed` (m/s). Its observer is fed its own command, or `logged_command` (N) [n], as on the machine:
    then it forgets its initial state. The reference's velocity and acceleration, which the log does not hold, are its
    central differences.
    """
    count = references.shape[1]
    # the length is rounded up, at rest at the end, so that logs of similar length share one compiled program
    block = next((size for size in WIDTHS if count <= 10 * size), WIDTHS[-1])
    width = block * -(-count // block)
    padding = ((0, 0), (0, width - count))
    rates = np.gradient(references, period, axis=1)
    reference = Reference(
        np.pad(references, padding, mode="edge"),
        np.pad(rates, padding),
        np.pad(np.gradient(rates, period, axis=1), padding),
    )
    positions = np.pad(positions, padding, mode="edge")
    logged_command = None if logged_command is None else np.pad(logged_command, (0, width - count), mode="edge")
    signals = as_arrays((reference, positions, np.asarray(speed), logged_command, np.asarray(period)))
    return np.asarray(_controller_commands(*arrays, *signals))[:, :count]


def is_memoryless(controller: Controller) -> bool:
    """Whether its output depends on the last samples alone: it has no integral and no observer that must settle."""
    return isinstance(controller, PD) or (isinstance(controller, Cascade) and float(controller.ki) == 0)


def is_linear(controller: Controller) -> bool:
    """Whether its initial state soon leaves no more than a constant: it has no observer of friction or load."""
    return not isinstance(controller, FrictionCompensation)
