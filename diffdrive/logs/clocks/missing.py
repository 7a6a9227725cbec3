"""Samples without a value: a few are interpolated, longer stretches become gaps, ragged ends are cut."""

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.clocks.interpolate import interpolate
from diffdrive.logs.log import READABLE, Samples, Signal

LONGEST_REPAIR = 5  # samples in a row
MOST_REPAIRED = 1e-3  # of all samples of a channel
MOST_ABSENT = 0.1  # of the samples of an optional channel; beyond, the channel is left out instead of the samples


def repair_missing(source: str, signals: dict[str, Signal]) -> tuple[dict[str, Samples], list[str]]:
    """The signals with every sample finite; the times of samples left out are missing, which makes them gaps.

    `signals` holds strictly increasing times beside the channels. Raises `LogError` where a required channel is empty.
    """
    signals = {name: np.where(np.isfinite(values), values, np.nan) for name, values in signals.items()}
    notes: list[str] = []
    for channel in [name for name, values in signals.items() if np.isnan(values).any()]:
        bad = np.isnan(signals[channel])
        required = READABLE[channel].required
        if required and bad.all():
            raise LogError(f"{source}: the {channel} has no value at all; name another column for it")
        if bad.all() or (not required and channel != "temperature" and bad.mean() > MOST_ABSENT):
            del signals[channel]
            notes.append(f"{channel}: {bad.mean():.0%} of its samples have no value; the channel was left out")
        elif channel == "temperature":  # slow, and often logged more rarely than the rest
            signals[channel] = np.interp(signals["time"], signals["time"][~bad], signals[channel][~bad])
            notes.append(f"temperature: {bad.sum()} samples without a value were interpolated")
        else:
            signals[channel], repaired = _interpolate_short(channel, signals["time"], signals[channel])
            if repaired:
                notes.append(f"{channel}: {repaired} samples without a value were interpolated")
    absent = np.any([np.isnan(values) for values in signals.values()], axis=0)
    if absent.all():
        raise LogError(f"{source}: no sample has a value in all of {', '.join(signals)}; leave out the emptiest column")
    if absent.any():
        notes += _removal_notes(absent)
        signals = {name: values[~absent] for name, values in signals.items()}
    return signals, notes


def true_stretches(mask: np.ndarray) -> list[tuple[int, int]]:
    """The stretches [begin, end) in which the mask is true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))


def _interpolate_short(channel: str, time: Signal, values: Signal) -> tuple[Signal, int]:
    """Short interior stretches interpolated, as long as they are few; and how many samples that were."""
    bad, short = np.isnan(values), np.zeros(len(values), dtype=bool)
    for begin, end in true_stretches(bad):
        if begin > 0 and end < len(values) and end - begin <= LONGEST_REPAIR:
            short[begin:end] = True
    if not short.any() or short.sum() > MOST_REPAIRED * len(values):
        return values, 0
    repaired = values.copy()
    repaired[short] = interpolate(channel, time[~bad], values[~bad], time[short])
    return repaired, int(short.sum())


def _removal_notes(absent: np.ndarray) -> list[str]:
    begin, end = int(np.argmin(absent)), len(absent) - int(np.argmin(absent[::-1]))
    notes = []
    if begin or end < len(absent):
        notes.append(f"{begin} samples at the start and {len(absent) - end} at the end have no value and were cut off")
    inside = int(absent[begin:end].sum())
    if inside:
        count = len(true_stretches(absent[begin:end]))
        notes.append(f"{inside} samples without a value were left out, which leaves {count} gaps")
    return notes
