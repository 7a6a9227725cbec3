"""Whether what a fit leaves follows the command: residual analysis (Ljung 1999, System Identification, section 16.6).

The filter may invent forces, lasting and sudden ones, but none that follows the command, time and again. A model whose
actuator answers as late as the machine's and yet differently, by a delay in the place of a lag, leaves innovations that
go with the commands of the samples before them, little as each is off.
"""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.actuator import limited
from tuning.diagnosis.curvature import solved
from tuning.diagnosis.exposure import Exposure
from tuning.diagnosis.fitting import Fitted, answered
from tuning.diagnosis.model import Logged

TAPS = 5  # samples, from the last to be asked for to the one before it
SHARE = 0.1  # of the command that each sample may add, one standard deviation
QUICK = 20.0  # scatters of the measurement a sample: a slower table's counts are no noise, and the command follows them
PIECE = 0.25  # s
SINGLE = 12.0  # of cost, that a piece of this length counts at most: one event that goes wrong is no answer to commands


def follows_command(fitted: Fitted) -> float:
    """By how much (-2 log likelihood) a force that is a sum of the last commands, added to a fit without effects within
    its filter, would explain the logs better, to first order and all that is free moved to make way.

    Where the table is slow, the counts of its scale are no noise, and the command follows them: it tells nothing.
    """
    logged = fitted.model.logged
    answers = np.asarray(_answers(fitted))
    quick = np.abs(np.asarray(fitted.track.course.velocity)) * logged.sampling.period >= QUICK * float(logged.noise)
    telling = quick.reshape(-1, 1) & (fitted.residual[:, None] != 0.0)
    ways = np.where(telling, answers.reshape(fitted.residual.size, -1), 0.0)
    residual = fitted.residual - fitted.jacobian @ solved(fitted.hessian, _slope(fitted))
    ways = ways - fitted.jacobian @ solved(fitted.hessian, fitted.jacobian.T @ ways)
    amounts = -solved(ways.T @ ways + np.eye(TAPS) / SHARE**2, ways.T @ residual)
    added = ways @ amounts
    gained = (-added * (2.0 * residual + added)).reshape(quick.shape)
    pieces = np.add.reduceat(gained, np.arange(0, gained.shape[1], max(1, round(PIECE * logged.sampling.rate))), axis=1)
    return float(np.sum(np.minimum(pieces, SINGLE)))


def _slope(fitted: Fitted) -> Float[np.ndarray, " k"]:
    return fitted.jacobian.T @ fitted.residual + fitted.u


def _answers(fitted: Fitted) -> Float[Array, "lanes n taps"]:
    """Of the residuals, to a newton and more of each of the last commands."""
    logged = fitted.model.logged
    force = jnp.stack([_held_back(logged, k) for k in range(TAPS)], axis=-1)
    none = jnp.zeros_like(force)
    still = jnp.zeros((fitted.linear.machine.shape[-1], TAPS))
    pushed = Exposure(force, none, none, none, none, none, none)
    found = answered(fitted.track, fitted.linear, still, pushed, logged.lanes.counts, logged.sampling.period)
    return found / jnp.sqrt(fitted.track.size)


def _held_back(logged: Logged, samples: int) -> Float[Array, "lanes n"]:
    """The command that many samples after the one at which the drive file has it act."""
    command = limited(logged.drive.actuator, logged.lanes.command)
    late = int(logged.delay) + samples
    return jnp.pad(command, ((0, 0), (late, 0)), mode="edge")[:, : command.shape[1]]
