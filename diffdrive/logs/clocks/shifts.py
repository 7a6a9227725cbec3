"""Channels that were recorded some samples early or late, aligned with the others."""

import itertools

import numpy as np

from diffdrive.errors import LogError
from diffdrive.support.messages import short_repr


def shift_channels(
    source: str, signals: dict[str, np.ndarray], gaps: tuple[int, ...], shifts: dict[str, int]
) -> tuple[dict[str, np.ndarray], tuple[int, ...], list[str]]:
    """The signals with some of them shifted by whole samples, positive to later times; the gaps, and notes.

    Each stretch between gaps loses at its ends what no longer has a partner. Raises `LogError` where a channel is not
    in the log, or nothing is left.
    """
    moved = {channel: samples for channel, samples in shifts.items() if samples}
    if not moved:
        return signals, gaps, []
    absent = [channel for channel in moved if channel not in signals]
    if absent:
        raise LogError(
            f"{source}: {absent[0]} is to be shifted: the log has no such channel; it has {', '.join(signals)}"
        )
    latest, earliest = max(0, *moved.values()), min(0, *moved.values())
    edges = [0, *gaps, len(next(iter(signals.values())))]
    spans = [(start + latest, stop + earliest) for start, stop in itertools.pairwise(edges)]
    stretches = [np.arange(start, stop) for start, stop in spans if start < stop]
    if not stretches:
        raise LogError(
            f"{source}: shifts by {short_repr(latest - earliest)} samples leave nothing of the log; correct them"
        )
    rows = np.concatenate(stretches)
    shifted = {channel: values[rows - moved.get(channel, 0)] for channel, values in signals.items()}
    new_gaps = tuple(int(k) for k in np.cumsum([len(stretch) for stretch in stretches[:-1]]))
    notes = [f"the {channel} was shifted by {samples:+d} samples" for channel, samples in moved.items()]
    return shifted, new_gaps, notes
