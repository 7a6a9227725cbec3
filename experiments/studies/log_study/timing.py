"""Faults of time: channels early or late, rows left out, clocks of another unit."""

from dataclasses import replace

import numpy as np

from diffdrive.logs.log import Log, Signal
from experiments.studies.log_study.fault import (
    FaultKind,
    LogFault,
    channel_fault,
    following_error,
    log_uniform,
    moving_samples,
    with_channels,
)
from experiments.studies.log_study.sound import LogCase
from experiments.studies.log_study.values import controller_known

CHANNELS = ("reference", "position", "command")


def delayed(signal: Signal, samples: float) -> Signal:
    """The signal delayed by so many samples, with linear interpolation and its end values repeated."""
    count = np.arange(len(signal))
    return np.interp(count - samples, count, signal)


def _shifted(case: LogCase, rng: np.random.Generator, samples: float, also: tuple[str, ...] = ()) -> LogFault | None:
    channel = str(rng.choice(CHANNELS))
    signal = delayed(getattr(case.log, channel), samples)
    if channel == "position":  # a scale has no values between its counts
        signal = case.drive.resolution * np.round(signal / case.drive.resolution)
    change = signal - getattr(case.log, channel)
    size = case.log.command if channel == "command" else following_error(case.log)
    if np.std(change) < 0.02 * np.std(size):
        return None

    def undo(log: Log) -> Log:
        return with_channels(log, {channel: delayed(getattr(log, channel), -samples)})

    # either of the two lengths may be the faulty one: only the lag of the command, which hardly changes, could tell
    channels = ("command",) if channel == "command" else ("reference", "position")
    amount = f"{channel} by {samples:+.3g} samples"
    return channel_fault(case, channel, signal, amount, "shifted", undo=undo, other_causes=also, channels=channels)


def shifted_whole(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """By 1 to 5 samples, either way."""
    return _shifted(case, rng, float(rng.integers(1, 6)) * float(rng.choice([-1.0, 1.0])))


def shifted_part(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """By 0.2 to 0.8 samples, either way: interpolated, which is a mean of two neighbours."""
    return _shifted(case, rng, rng.uniform(0.2, 0.8) * float(rng.choice([-1.0, 1.0])), ("filtered",))


def _select_rows(log: Log, rows: Signal | slice) -> Log:
    return with_channels(log, {name: signal[rows] for name, signal in log.channels.items()})


def decimated(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Each n-th row, with the time stamps of consecutive rows: as the time of a slower log in another unit."""
    factor = int(rng.integers(2, 11))
    true = _select_rows(case.log, slice(None, None, factor))

    def undo(log: Log) -> Log:
        return replace(log, time=log.time[0] + factor * (log.time - log.time[0]))

    return LogFault(
        replace(true, time=case.log.time[: len(true.time)]), true, f"each {factor}th row", ("decimated", "rate"),
        undo=undo,
    )  # fmt: skip


def decimated_with_time(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Each n-th row with its time: the log is right, but its controller cannot be replayed."""
    factor = int(rng.integers(2, 11))
    true = _select_rows(case.log, slice(None, None, factor))
    return LogFault(true, true, f"each {factor}th row", ("decimated", "rate"))


def wrong_unit(case: LogCase, rng: np.random.Generator) -> LogFault:
    """Milliseconds taken as microseconds or as seconds."""
    factor = float(rng.choice([1e3, 1e-3]))
    log = case.log

    def undo(wrong: Log) -> Log:
        return replace(wrong, time=wrong.time / factor)

    return LogFault(replace(log, time=factor * log.time), log, f"time x {factor:g}", ("rate",), undo=undo)


def lost_rows(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """One to five places at which 1 to 50 rows are missing during the motion, the time stamps uniform all the same."""
    log = case.log
    assert log.reference is not None
    places = rng.choice(moving_samples(log)[50:-50], int(rng.integers(1, 6)), replace=False)
    counts = [round(log_uniform(rng, 1, 50)) for _ in places]
    lost = np.unique(np.concatenate([np.arange(p, p + n) for p, n in zip(places, counts, strict=True)]))
    lost = lost[lost < len(log.time) - 50]
    jump = max(
        abs(log.reference[min(p + n, len(log.time) - 1)] - log.reference[p])
        for p, n in zip(places, counts, strict=True)
    )
    if jump < 20 * case.drive.resolution:
        return None
    true = _select_rows(log, np.delete(np.arange(len(log.time)), lost))
    return LogFault(
        replace(true, time=log.time[: len(true.time)]), true, f"{len(lost)} at {len(places)} places", ("lost rows",)
    )  # fmt: skip


TIMING_FAULTS = (
    FaultKind("shifted by whole samples", shifted_whole, controller_known),
    FaultKind("shifted by part of a sample", shifted_part, controller_known),
    FaultKind("rows left out, time renumbered", decimated),
    FaultKind("rows left out, time kept", decimated_with_time),
    FaultKind("unit of the time", wrong_unit),
    FaultKind("rows lost under uniform stamps", lost_rows),
)
