"""Whether a mended log is the log as it should have been."""

from dataclasses import replace

import numpy as np

from diffdrive.logs.log import Log, Signal
from experiments.log_study.fault import Fault, following_error

LENGTHS = ("reference", "position", "motor_position")
# What a mended log may be off by and still give the same drive: force constants are known to 2 %, scales to 0.1 %.
COMMAND, LENGTH, ERROR, RATE = 0.02, 1e-3, 0.05, 1e-4
MOST_LAG = 8  # samples by which all channels may be moved together: that changes nothing
MARGIN = 0.02  # of the log at either end, where a shifted channel repeats its last value


def lost_by(fault: Fault) -> dict[str, float]:
    """By channel, the RMS of what cannot be brought back: after `undo`, or as the log is where nothing undoes it."""
    best = fault.log if fault.undo is None else fault.undo(fault.log)
    inner = _inner(len(best.time))
    lost = {name: _rms((best.channels[name] - signal)[inner]) for name, signal in fault.true.channels.items()}
    lost["error"] = _rms((following_error(best) - following_error(fault.true))[inner])
    return {name: 1.5 * size for name, size in lost.items()}


def differences(mended: Log, fault: Fault, resolution: float) -> list[str]:
    """In what the mended log is not the true one, channel by channel; empty where it is.

    A common zero of all lengths, and a common delay of all channels, count as equal: no log has a zero of its own.
    """
    true = fault.true
    if set(mended.channels) != set(true.channels) or len(mended.time) != len(true.time):
        return ["channels or rows"]
    found = []
    if abs(_step(mended) / _step(true) - 1.0) > RATE:
        found.append("time")
    lag = _lag(mended, true)
    inner = _inner(len(true.time))
    mended = replace(
        mended, **{name: np.roll(mended.channels[name], lag) for name in mended.channels if name != "time"}
    )
    zero = float(np.median((mended.position - true.position)[inner]))
    lost = lost_by(fault)
    for name, signal in true.channels.items():
        if name == "time":
            continue
        ours = mended.channels[name] - (zero if name in LENGTHS else 0.0)
        allowed = LENGTH * float(np.ptp(signal)) + resolution if name in LENGTHS else COMMAND * float(np.std(signal))
        if not _rms((ours - signal)[inner]) <= allowed + lost[name]:
            found.append(name)
    error = following_error(true)
    allowed = max(ERROR * float(np.std(error)), 2 * resolution) + lost["error"]
    if not _rms((following_error(mended) - error)[inner]) <= allowed:
        found.append("following error")
    return found


def _step(log: Log) -> float:
    return float(np.median(np.diff(log.time)))


def _lag(mended: Log, true: Log) -> int:
    """By how many samples all channels of the mended log are early."""
    inner = _inner(len(true.time))

    def off(lag: int) -> float:
        return sum(
            _rms((np.roll(mended.channels[name], lag) - true.channels[name])[inner])
            / max(float(np.std(true.channels[name])), 1e-300)
            for name in ("reference", "position", "command")
        )

    return min(range(-MOST_LAG, MOST_LAG + 1), key=lambda lag: (off(lag), abs(lag)))


def _inner(count: int) -> slice:
    edge = max(2 * MOST_LAG, int(MARGIN * count))
    return slice(edge, count - edge)


def _rms(values: Signal) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
