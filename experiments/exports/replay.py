"""A run for the bench: what the controller was given in a simulation, and what its simulated step answered."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.axis import Axis
from diffdrive.controllers import Controller, Reference
from diffdrive.controllers.base import Command, Encoders
from diffdrive.loop.run import Run
from diffdrive.model.friction import resolvable
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import Scalar, as_arrays, in_precision_of
from experiments.exports.program import Program
from experiments.exports.trace import ESTIMATES


class Replay(NamedTuple):
    """Columns by name, inputs first and then outputs, [n] each."""

    inputs: dict[str, Float[np.ndarray, " n"]]
    outputs: dict[str, Float[np.ndarray, " n"]]

    def as_csv(self) -> str:
        """A column for each input, then for each output; every number exact to its last bit."""
        names = [*self.inputs, *(f"simulated_{name}" for name in self.outputs)]
        columns = [column.tolist() for column in (*self.inputs.values(), *self.outputs.values())]
        rows = (",".join(map(repr, row)) for row in zip(*columns, strict=True))
        return "\n".join([",".join(names), *rows]) + "\n"


def replay_of(program: Program, axis: Axis, motion: Motion, run: Run, *, single: bool = False) -> Replay:
    """The replay of a run: the simulated controller alone, given what it was given in the run.

    It begins where the motion does: a bench may hold no more than the first samples, and at rest they prove nothing.
    The force that is fed back is the one that acted in the run, as a machine would measure it. With `single` the
    simulator computes in single precision, too.
    """
    applied = np.concatenate([[0.0], run.force[:-1]])
    motor = run.measured if run.motor_position is None else run.motor_position
    given = {
        "reference_position": motion.position,
        "reference_velocity": motion.velocity,
        "reference_acceleration": motion.acceleration,
        "scale_position": run.measured,
        "motor_position": motor,
        "applied_force": applied,
    }
    begin = max(int(np.argmax(motion.position != motion.position[0])) - 1, 0)
    given = {name: one[begin:] for name, one in given.items()}
    signals = {name: jnp.asarray(one) for name, one in given.items()}
    arguments = as_arrays(axis.controller), signals
    if single:
        arguments = jax.tree.map(lambda leaf: leaf.astype(jnp.float32), arguments)
    command = _answers(*arguments, arguments[1][program.measured][0], program.period)
    outputs: dict[str, Any] = {"force": command.force}
    if command.estimate is not None:
        estimate = command.estimate
        outputs |= {ESTIMATES[name].name: value for name, value in estimate._asdict().items() if value is not None}
    return Replay(
        {one.name: np.asarray(given[one.name]) for one in program.inputs},
        {one.name: np.asarray(outputs[one.name]) for one, _ in program.outputs},
    )


@eqx.filter_jit
def _answers(controller: Controller, given: dict[str, Array], start: Scalar, period: float) -> Command:
    """The command at each sample, from rest at a position."""
    controller = resolvable(controller)

    def step(state: object, now: dict[str, Array]) -> tuple[object, Command]:
        reference = Reference(now["reference_position"], now["reference_velocity"], now["reference_acceleration"])
        encoders = Encoders(now["scale_position"], now["motor_position"])
        return controller.step_from_encoders(state, reference, encoders, now["applied_force"], period)

    return jax.lax.scan(step, in_precision_of(start, controller.init(start)), given)[1]
