"""The force of the motor in each row of a log, from the logged command.

Where every sample of the control is logged, a row's command is held until the next row (`BetweenRows.HELD`). The rows
of a slower trace are snapshots of a command that goes on changing between them (`BetweenRows.SMOOTH`): there it is the
cubic through the four rows about it. Read as held, with a delay for the half row that this is late, a force of the
frequency w would move a mass by (w T)^2 / 6 less over rows of a time T: half of that for its mean over a row, which is
not that of the chord, and half for its change within the row. The mass would seem lighter by as much.
"""

import enum
from math import comb
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive.model import plant
from diffdrive.model.actuator import saturate
from diffdrive.model.current_loop import mean_forces, ramp_lag
from diffdrive.model.parameters import Actuator, Drive, Sampling
from diffdrive.numerics.arrays import Scalar

MAX_DELAY = 8  # rows
MIN_DELAY = -1  # a command that is logged one row late
AT_ONCE = -0.5  # rows: the delay of a smooth command that acts at the instant of its row
MOST_SAMPLES = 16  # of a loop, that are told in a row
NODES = (-1, 0, 1, 2)  # rows about a row's middle, through which the cubic goes
POWERS = np.linalg.inv(np.vander(NODES, increasing=True))  # [power, node]: coefficients of the polynomial


class BetweenRows(enum.Enum):
    """What the command does from one row of a log to the next."""

    HELD = "held"  # a row is a control period
    SMOOTH = "smooth"  # rows are snapshots of a faster loop


class RowForce(NamedTuple):
    """The force of the motor (N) in each row: its mean, and how it changes within the row.

    `change` has the coefficients of the first powers of the time since the row's middle, in rows; None where the force
    is held.
    """

    mean: Float[Array, " n"]
    change: Float[Array, "n 3"] | None = None


def loop_samples(delay: float) -> int:
    """How many samples of its loop a row lasts, as the `delay` of its smooth command shows it.

    The loop holds each command for one of its samples, so that it acts half of one late. What acts as late as a command
    that is held for all of its row is one sample.
    """
    late = max(delay - AT_ONCE, 0.5 / MOST_SAMPLES)
    return max(1, round(0.5 / late))


def applied_force(
    actuator: Actuator, command: Float[Array, " n"], delay: Scalar, period: float, between: BetweenRows
) -> RowForce:
    """The force of the motor in each row.

    The command is limited, answered by the current loop where one is stated, and delayed by `delay` rows. That of
    snapshots lags in the current loop as a ramp does.
    """
    requested = jnp.asarray(saturate(actuator, command))
    if between is BetweenRows.HELD:
        return RowForce(delayed(mean_forces(actuator, requested, period), delay))
    return smooth(requested, delay + ramp_lag(actuator) / period)


def advance(
    drive: Drive, state: plant.PlantState, force: RowForce, load: Scalar, sampling: Sampling
) -> plant.PlantState:
    """The table one row later; `force` is that of the row alone."""
    ripple = None
    if force.change is not None:
        time = (np.arange(sampling.plant_steps) + 0.5) / sampling.plant_steps - 0.5
        departures = np.stack([time**power - np.mean(time**power) for power in range(1, len(NODES))])
        ripple = jnp.einsum("k,ks->s", force.change, departures)
    return plant.advance(drive, state, force.mean, load, sampling.period, sampling.plant_steps, ripple)


def delayed(command: Float[Array, " n"], delay: Scalar) -> Float[Array, " n"]:
    """The command `delay` rows later, linear between rows, as a held one acts on average; before the log its first."""
    shifted = jnp.zeros_like(command)
    # not 1 - |delay - periods|: at whole delays, where searches start, its derivative is none of this one's
    samples = lax.stop_gradient(jnp.clip(jnp.floor(delay), MIN_DELAY, MAX_DELAY - 1))
    fraction = delay - samples
    for periods in range(MIN_DELAY, MAX_DELAY + 1):
        share = jnp.where(periods == samples, 1.0 - fraction, jnp.where(periods == samples + 1, fraction, 0.0))
        if periods >= 0:
            past = jnp.concatenate([jnp.full(periods, command[0]), command[: len(command) - periods]])
        else:
            past = jnp.concatenate([command[-periods:], jnp.full(-periods, command[-1])])
        shifted = shifted + share * past
    return shifted


def smooth(command: Float[Array, " n"], delay: Scalar) -> RowForce:
    """The force in each row where the command is a smooth one; beyond the log its end values.

    `delay` is that of a held command of the same mean (rows), so that a command which acts at once has `AT_ONCE`: half
    a row ahead of a row's first instant is its middle.
    """
    whole = lax.stop_gradient(jnp.floor(-jnp.asarray(delay)))
    at = jnp.arange(len(command)) + whole.astype(int)
    rows = [command[jnp.clip(at + node, 0, len(command) - 1)] for node in NODES]
    powers = [sum(weight * row for weight, row in zip(weights, rows, strict=True)) for weights in POWERS]
    about = [  # the same polynomial in the time since the middle
        sum(comb(j, k) * powers[j] * (-delay - whole) ** (j - k) for j in range(k, len(NODES)))
        for k in range(len(NODES))
    ]
    mean = about[0] + about[2] / 12.0  # of t^2 over a row
    return RowForce(mean, jnp.stack(about[1:], axis=-1))
