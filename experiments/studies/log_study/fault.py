"""A log with a known fault, and the kinds of faults that are drawn."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from diffdrive.logs.log import Log, Signal
from experiments.studies.log_study.drives import StudyDrive
from experiments.studies.log_study.sound import LogCase

ANY_CHANNEL: tuple[str, ...] = ()
COMMAND_SHARE = 0.02  # of its standard deviation: force constants are not known better, and less changes no result


@dataclass(frozen=True)
class LogFault:
    """A log with something wrong, and the truth about it.

    `causes` are the names that are right, `rivals` those that cannot be ruled out and must be named as well; `channels`
    are those that a finding may be about (none: any). `true` is the log as it should be: the repaired one must equal
    it, but for what the fault destroyed; `undo` repairs it as far as that is possible.
    """

    log: Log
    true: Log
    amount: str
    causes: tuple[str, ...]
    channels: tuple[str, ...] = ANY_CHANNEL
    rivals: tuple[str, ...] = ()
    undo: Callable[[Log], Log] | None = None


@dataclass(frozen=True)
class FaultKind:
    """One kind of fault. `draw` draws one, None where this motion cannot show it; `applies` says which axes can."""

    name: str
    draw: Callable[[LogCase, np.random.Generator], LogFault | None]
    applies: Callable[[StudyDrive], bool] = lambda drive: True


def with_channels(log: Log, channels: Mapping[str, Signal]) -> Log:
    """The log with other signals in these channels."""
    changes: dict[str, Any] = dict(channels)
    return replace(log, **changes)


def channel_fault(
    case: LogCase, channel: str, signal: Signal, amount: str, cause: str, *, undo: Callable[[Log], Log] | None = None,
    other_causes: tuple[str, ...] = (), channels: tuple[str, ...] | None = None, rivals: tuple[str, ...] = (),
) -> LogFault:  # fmt: skip
    """A fault of one channel."""
    return LogFault(
        with_channels(case.log, {channel: signal}), case.log, amount, (cause, *other_causes),
        (channel,) if channels is None else channels, rivals, undo,
    )  # fmt: skip


def robust_range(signal: Signal) -> float:
    """The range of a signal between its 0.5 % and 99.5 % quantiles, which no single sample determines."""
    low, high = np.quantile(signal, [0.005, 0.995])
    return float(high - low)


def noise_std(signal: Signal) -> float:
    """Standard deviation of the white noise in a signal, from its second differences."""
    return float(1.4826 * np.median(np.abs(np.diff(signal, 2))) / np.sqrt(6.0))


def following_error(log: Log) -> Signal:
    """Reference minus position (m)."""
    assert log.reference is not None
    return log.reference - log.position


def moving_samples(log: Log) -> Signal:
    """Samples at which the reference moves at more than a fifth of its top speed."""
    assert log.reference is not None
    speed = np.abs(np.gradient(log.reference))
    return np.flatnonzero(speed > 0.2 * np.max(speed))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Uniform in the logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
