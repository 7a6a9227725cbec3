"""The running costs of a roll-out, for many lanes that keep no signal."""

from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

from diffdrive.controllers import Controller
from diffdrive.effects import stages
from diffdrive.loop.metrics import safe_sqrt
from diffdrive.loop.rollout import scanned
from diffdrive.loop.step import Inputs, initial_state, step
from diffdrive.model.friction import resolvable
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.motion.load import Ramp
from diffdrive.numerics.arrays import Scalar, require_double_precision


class Costs(NamedTuple):
    """Running costs of a roll-out over the samples that are counted."""

    rms: Scalar  # m, tracking error
    peak: Scalar  # m, largest tracking error
    command_noise: Scalar  # N, RMS of the command's sample-to-sample change over sqrt 2
    load_error: Scalar | None  # N, RMS of the estimated minus the true load; None where no load is estimated
    saturated: Scalar  # share of the samples at which the command exceeded the force limit
    steps_finite: Scalar  # how many control steps passed before the tracking error left its bound, or was not finite


def running_costs(
    drive: Drive,
    controller: Controller,
    inputs: Inputs,
    counts: Float[Array, " n"],
    sampling: Sampling,
    key: Array | None = None,
    ramp: Ramp | None = None,
    checkpoint_every: int = 1,
    divergence_bound: Scalar = 1.0,
) -> Costs:
    """Roll the loop and keep only its costs, over the samples where `counts` is 1: no memory, for many lanes.

    `ramp` is a load beside that of `inputs`, for lanes whose loads differ by more than a factor. `checkpoint_every`: as
    in `rollout_loop`. A loop whose tracking error is beyond `divergence_bound` (m; see `run.divergence_bound`) has
    diverged. It runs in the precision of its input arrays, all of one kind; its sums are always double.

    Pure, as `rollout_loop`. Differentiable, but for the peak's and the divergence count's kinks.
    """
    require_double_precision()
    drive, controller = resolvable((stages.with_machine_effects(drive, drive.effects), controller))
    limit = stages.force_limit(drive)
    limit = jnp.inf if limit is None else limit

    def body(carry: PyTree, inputs_now: tuple[Inputs, Scalar]) -> tuple[PyTree, None]:
        state, last, (square, largest, change, load_error, limited, finite) = carry
        now, count = inputs_now
        if ramp is not None:
            now = now._replace(load=now.load + ramp.at(sampling.period * state.count))
        state, frame = step(drive, controller, sampling, key, state, now)
        error = now.reference.position - frame.table_position
        estimated_load = None if frame.estimate is None else frame.estimate.load
        counts_change = jnp.where(state.count > 1, count, 0.0)  # the first sample has no change of command
        # what does not count may be anything, infinite too
        tracking_error, command_change = (
            jnp.where(count > 0.0, error, 0.0),
            jnp.where(counts_change > 0.0, frame.command - last, 0.0),
        )
        load_deviation = None if estimated_load is None else jnp.where(count > 0.0, estimated_load - now.load, 0.0)
        sums = (
            square + count * tracking_error**2,
            jnp.maximum(largest, count * jnp.abs(tracking_error)),
            change + counts_change * command_change**2,
            None if load_deviation is None else load_error + count * load_deviation**2,
            limited + count * jnp.where(jnp.abs(frame.command) > limit, 1.0, 0.0),
            finite
            + jnp.where((jnp.abs(error) <= divergence_bound) & (finite == state.count - 1), 1, 0).astype(jnp.uint32),
        )
        return (state, frame.command, sums), None

    zero = jnp.zeros(())  # sums stay in double precision, whatever the loop runs in
    begin = initial_state(drive, controller, cast(Array, inputs.reference.position)[0])
    zero_command = jnp.zeros_like(begin.plant.position)
    first_inputs = Inputs(*jax.tree.map(lambda signal: signal[0], tuple(inputs)))
    estimate = jax.eval_shape(lambda: step(drive, controller, sampling, key, begin, first_inputs)[1].estimate)
    load_error = None if estimate is None or estimate.load is None else zero
    sums = (zero, zero, zero, load_error, zero, jnp.zeros((), jnp.uint32))
    (_, _, (square, largest, change, load_error, limited, finite)), _ = scanned(
        body, (begin, zero_command, sums), (inputs, counts), checkpoint_every
    )
    total = jnp.sum(counts)
    # reciprocals, explicitly: else the compiler may or may not make one of a division, which changes the last bits
    per_sample, per_change = 1.0 / total, 0.5 / (total - counts[0])
    return Costs(
        rms=safe_sqrt(square * per_sample),
        peak=largest,
        command_noise=safe_sqrt(change * per_change),
        load_error=None if load_error is None else safe_sqrt(load_error * per_sample),
        saturated=limited * per_sample,
        steps_finite=finite,
    )
