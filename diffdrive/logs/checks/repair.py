"""Repairs of a log, as data: steps that are applied one after the other."""

import abc
from dataclasses import dataclass

import numpy as np

from diffdrive.logs.log import Log, Signal


def shift_signal(signal: Signal, samples: float) -> Signal:
    """The signal some samples later (negative: earlier), between samples by interpolation, its end values repeated."""
    rows = np.arange(len(signal)) - samples
    if samples == round(samples):
        return signal[np.clip(rows, 0, len(signal) - 1).astype(int)]
    return np.interp(rows, np.arange(len(signal)), signal)


class RepairStep(abc.ABC):
    """One elementary repair."""

    @abc.abstractmethod
    def apply(self, log: Log) -> Log:
        """The log after it."""


def _require_channel(log: Log, channel: str) -> Signal:
    signal = log.channels.get(channel)
    if signal is None:
        raise KeyError(f"{log.name} has no {channel}")
    return signal


@dataclass(frozen=True)
class ScaleChannel(RepairStep):
    """Multiply a channel; of `time`, its distance from the first sample."""

    channel: str
    factor: float

    def apply(self, log: Log) -> Log:
        signal = _require_channel(log, self.channel)
        origin = float(signal[0]) if self.channel == "time" else 0.0
        return log.replace(**{self.channel: origin + self.factor * (signal - origin)})


@dataclass(frozen=True)
class AddToChannel(RepairStep):
    """Add a constant to a channel."""

    channel: str
    amount: float

    def apply(self, log: Log) -> Log:
        return log.replace(**{self.channel: _require_channel(log, self.channel) + self.amount})


@dataclass(frozen=True)
class ShiftChannel(RepairStep):
    """Move a channel by some samples: positive later."""

    channel: str
    samples: float

    def apply(self, log: Log) -> Log:
        return log.replace(**{self.channel: shift_signal(_require_channel(log, self.channel), self.samples)})


@dataclass(frozen=True)
class SwapChannels(RepairStep):
    """Exchange two channels."""

    first: str
    second: str

    def apply(self, log: Log) -> Log:
        first, second = _require_channel(log, self.first), _require_channel(log, self.second)
        return log.replace(**{self.first: second, self.second: first})


@dataclass(frozen=True)
class UnwrapChannel(RepairStep):
    """Take out the jumps of a counter that overflows."""

    channel: str
    span: float  # of the counter, in the channel's unit

    def apply(self, log: Log) -> Log:
        return log.replace(**{self.channel: np.unwrap(_require_channel(log, self.channel), period=self.span)})


@dataclass(frozen=True)
class Repair:
    """Steps that undo a fault of a log, the first to be done first."""

    steps: tuple[RepairStep, ...]

    def apply(self, log: Log) -> Log:
        """The repaired log; raises `KeyError` where the log lacks a channel."""
        for step in self.steps:
            log = step.apply(log)
        return log
