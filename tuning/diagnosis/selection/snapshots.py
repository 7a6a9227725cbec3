"""How the command of a log acts where its rows are snapshots of a loop that is faster than the log.

The loop holds each of its commands until its next one. Of a row the first is logged; all of them are taken from the
cubic through the rows about it (`row_force`). Read as held until the next row, the command would act late by half of
what a row lasts beyond a sample of the loop, and its change within the row would be a force that the model lacks
wherever the force changes: no effect of a machine explains that.

A loop answers the noise of its encoder, and what it answered at the row's own instant is logged. So the cubic goes
through the commands that the law of the loop has (`loop_command`). Where the logs show none, it goes through the
commands without what looks like noise (`command_noise`) or with it, whichever has the drive file's drive follow the
logs more likely.

What is in no row is a force of each row its own, as large as the likelihood has it, and no effect's:
`goodness_of_fit.missing_evidence` allows it. The instant of a row is known to a sample of its loop: recalibration moves
it (`calibration.DELAY`), so that no effect is found that is but that.
"""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.logs import Log
from diffdrive.model.parameters import Sampling
from tuning.diagnosis.fits.fitting import BEGIN, Fitter
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.model import Logged, Model
from tuning.diagnosis.selection.search import initial_trajectory
from tuning.identification.loop_command import loop_command
from tuning.identification.padding import padded
from tuning.identification.problem import lanes_of
from tuning.identification.row_force import AT_ONCE, NODES, BetweenRows, smooth
from tuning.identification.snapshots import as_read


def read_snapshots(logged: Logged, logs: Sequence[Log], loop_samples: int) -> Logged:
    """The logs, each row being the first of so many samples of its loop."""
    law = loop_command(logs)
    if law is None:
        quiet = as_read(logged.lanes, BetweenRows.SMOOTH).command
        return min((as_snapshots(logged, loop_samples, one) for one in (quiet, logged.lanes.command)), key=_cost)
    of_law = [log.replace(command=one) for log, one in zip(logs, law.commands, strict=True)]
    read = as_snapshots(logged, loop_samples, padded(lanes_of(of_law)).command)
    return read._replace(command_std=jnp.asarray(law.std))


def _cost(logged: Logged) -> float:
    """Of the drive file's drive, under the likeliest forces that it may lack."""
    fitter, model = Fitter(logged), Model(logged)
    point = fitter.at(model, np.zeros(len(NAMES)), BEGIN, initial_trajectory(logged))
    return fitter.with_process(point, model, fitter.first).cost


def as_snapshots(logged: Logged, loop_samples: int, command: Float[Array, "lanes n"]) -> Logged:
    """The same logs, each row being the first of so many samples, the commands of which are of the cubic through
    `command`.
    """
    rate, steps = logged.sampling.rate, logged.sampling.plant_steps
    commands = jax.vmap(lambda rows: within_rows(rows, loop_samples))(command)
    return logged._replace(
        lanes=logged.lanes._replace(command=commands.mean(axis=2), period_commands=commands),
        sampling=Sampling(rate, loop_samples * -(-steps // loop_samples)),
        loop_samples=loop_samples,
    )


def within_rows(command: Float[Array, " n"], samples: int) -> Float[Array, "n samples"]:
    """A smooth command (N) at so many even instants of each row, the first of them the row's own."""
    force = smooth(command, jnp.asarray(AT_ONCE))
    if force.change is None:
        raise ArithmeticError("the command of snapshots changes within a row")
    time = np.arange(samples) / samples - 0.5
    powers = range(1, len(NODES))
    centred = force.mean - force.change[:, 1] / 12.0  # at the row's middle: of t^2 the mean over a row is a twelfth
    return centred[:, None] + force.change @ np.stack([time**power for power in powers])
