"""The drive file's controller replayed on the logged reference and position: the command that it should have given."""

from collections.abc import Callable
from typing import cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.axis import Axis
from diffdrive.controllers import Controller, Reference
from diffdrive.model import actuator
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar, as_arrays, require_double_precision

WIDTHS = (4096, 65_536)  # samples; of what has more than ten times as many the next
Difference = Callable[[np.ndarray, float], np.ndarray]  # of signals [m, n] and their period
Carry = tuple[PyTree, actuator.ActuatorState]  # the controller's state and the actuator's
SETTLE = 10  # samples until the controller's differences are those of the log


@eqx.filter_jit
def _controller_commands(
    controller: Controller,
    drive: Drive,
    references: Reference,
    positions: Float[Array, "m n"],
    speed: Float[Array, ""],
    logged_command: Float[Array, " n"] | None,
    period: Float[Array, ""],
) -> Float[Array, "m n"]:
    def replay(reference: Reference, position: Float[Array, " n"]) -> Float[Array, " n"]:
        def body(carry: Carry, inputs: tuple[Reference, Scalar, Scalar | None]) -> tuple[Carry, Scalar]:
            state, actuator_state = carry
            reference, position, logged_force = inputs
            state, command = controller.step(state, reference, position, actuator_state.applied, cast(float, period))
            # without the log's command, the controller's own: a wrong unit does not reach its observer
            force = command.force if logged_force is None else logged_force
            actuator_state = actuator.step(drive.actuator, actuator_state, force, cast(float, period))
            return (state, actuator_state), command.force

        initial = (_initial_state(controller, position[0], speed), actuator.init(drive.actuator))
        return cast(Array, lax.scan(body, initial, (reference, position, logged_command))[1])

    return jax.vmap(replay)(references, positions)


def _initial_state(controller: Controller, position: Scalar, speed: Scalar) -> PyTree:
    """The controller's state at a speed (m/s). An observer that begins at rest would take the motion for a shock."""
    return controller.moving(controller.init(position), position, speed)


ControllerAndDrive = tuple[Controller, Drive]


def central(signals: np.ndarray, period: float) -> np.ndarray:
    """The derivative of signals [m, n] by the samples before and after: nearest to that of a profile."""
    return np.gradient(signals, period, axis=1)


def backward(signals: np.ndarray, period: float) -> np.ndarray:
    """By this sample and the one before, as a controller takes it that is given positions: half a sample late."""
    return np.diff(signals, axis=1, prepend=signals[:, :1]) / period


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
    difference: Difference = central,
) -> np.ndarray:
    """Commands (N) [m, n] of the controller for m pairs of reference and position (m) [m, n], `period` (s) apart.

    It begins at `speed` (m/s). Its observer is fed its own command, or `logged_command` (N) [n], as on the machine:
    then it forgets its initial state. The reference's velocity and acceleration, which the log does not hold, are its
    first and second `difference`.
    """
    count = references.shape[1]
    # the length is rounded up, at rest at the end, so that logs of similar length share one compiled program
    block = next((size for size in WIDTHS if count <= 10 * size), WIDTHS[-1])
    width = block * -(-count // block)
    padding = ((0, 0), (0, width - count))
    rates = difference(references, period)
    reference = Reference(
        _array(np.pad(references, padding, mode="edge")),
        _array(np.pad(rates, padding)),
        _array(np.pad(difference(rates, period), padding)),
    )
    position = _array(np.pad(positions, padding, mode="edge"))
    command = None if logged_command is None else _array(np.pad(logged_command, (0, width - count), mode="edge"))
    return np.asarray(_controller_commands(*arrays, reference, position, _array(speed), command, _array(period)))[
        :, :count
    ]


def _array(values: np.ndarray | float) -> Array:
    return jnp.asarray(values, dtype=jnp.float64)
