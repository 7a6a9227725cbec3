"""What a trace records of a simulated motion: the rows of its log, as a pure function of its signals."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.loop.signals import Signals
from diffdrive.model.trace import Trace
from diffdrive.numerics.arrays import Scalar

Signal = Float[Array, "..."] | Float[np.ndarray, "..."]  # time is its last axis
AnySignals = Signals[np.ndarray] | Signals[Array]

COLUMN = 2  # folded into a trace's key: its noise is independent of that of the encoders


class Recording(NamedTuple):
    """The columns of a trace's rows, [rows] each; lanes come first where the signals have them."""

    time: Signal  # s
    reference: Signal  # m
    position: Signal  # m
    motor_position: Signal | None  # m
    command: Signal  # N
    load: Signal  # N


def record(signals: AnySignals, trace: Trace, key: Array | None = None) -> Recording:
    """The rows that a trace writes of the signals of a run or a roll-out, which have every sample of the control.

    Pure, for `jit`, `vmap` and derivatives: of means, and of `command_offset` and `command_noise`. `key` is that of the
    noise of the command column (None: no noise). Raises `ParameterError` where the trace's rate does not divide that of
    the signals.

    Examples:
        >>> rows = record(rollout(axis, motion), Trace(rate=1000.0, sample="mean"))
        >>> rows.position

    """
    times, rows = signals.sample_times(), rows_of(signals, trace)

    def sampled(signal: Signal) -> Signal:
        if trace.sample == "snapshot" or rows.step == 1:
            return signal[..., rows]
        whole = signal[..., : rows.stop]
        return jnp.mean(jnp.reshape(whole, (*whole.shape[:-1], -1, rows.step)), axis=-1)

    command = signals.command if trace.command == "set-point" else signals.force
    if trace.command_offset is not None:
        command = held_at(command, trace.command_offset * rate_of(signals))
    command = sampled(command)
    if trace.command_noise is not None and key is not None:
        normal = jax.random.normal(jax.random.fold_in(key, COLUMN), jnp.shape(command), jnp.float64)
        command = command + trace.command_noise * normal
    position = sampled(signals.measured)
    motor_position = None if signals.motor_position is None else sampled(signals.motor_position)
    if trace.encoders == "motor" and motor_position is not None:
        position = motor_position
    return Recording(
        time=times[rows],
        reference=sampled(signals.reference),
        position=position,
        motor_position=motor_position if trace.encoders == "all" else None,
        command=command,
        load=sampled(signals.load),
    )


def rate_of(signals: AnySignals) -> float:
    """Samples per second of a run or a roll-out."""
    times = signals.sample_times()
    return (len(times) - 1) / float(times[-1] - times[0])


def rows_of(signals: AnySignals, trace: Trace) -> slice:
    """The samples at which a trace writes its rows; raises `ParameterError` where its rate does not divide theirs."""
    return trace.rows(len(signals.sample_times()), rate_of(signals))


def held_at(signal: Signal, later: Scalar) -> Signal:
    """A signal that is held from sample to sample, `later` so many samples; linear in between, held at its ends.

    Linear in between is the mean of the held signal over one sample.
    """
    count = signal.shape[-1]
    whole = jax.lax.stop_gradient(jnp.floor(later))
    part = later - whole
    first = jnp.arange(count) + whole.astype(int)
    early, late = (jnp.take(signal, jnp.clip(first + k, 0, count - 1), axis=-1) for k in (0, 1))
    return (1.0 - part) * early + part * late
