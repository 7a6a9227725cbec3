"""Whether a mended log is the log as it should have been."""

import numpy as np

from diffdrive.logs.log import Log, Signal
from experiments.studies.log_study.fault import COMMAND_SHARE, LogFault, following_error

LENGTHS = ("reference", "position", "motor_position")
ERROR = "following error"
# What a mended log may be off by and still give the same drive: scales are known to 0.1 %, clocks to better than this.
LENGTH_SHARE, ERROR_SHARE, RATE = 1e-3, 0.05, 1e-4
SHIFTABLE = ("reference", "position", "command")
MAX_SKEW = 0.1  # samples by which these may be early or late against one another: it counts as a delay of the drive
MAX_LOSS = 1.5  # times what the best mend leaves, that another may leave
MAX_LAG = 8  # samples by which all channels may be moved together: that changes nothing
MARGIN = 0.02  # of the log at either end, where a shifted channel repeats its last value


def differences(mended: Log, fault: LogFault, resolution: float) -> list[str]:
    """In what the mended log is not the true one, channel by channel; empty where it is.

    A common zero of all lengths, and a common delay of all channels, count as equal: no log has a zero of its own. What
    even `undo` cannot bring back is allowed for; where nothing undoes the fault, its channel may stay as it is.
    """
    true = fault.true
    if set(mended.channels) != set(true.channels) or len(mended.time) != len(true.time):
        return ["channels or rows"]
    best = fault.log if fault.undo is None else fault.undo(fault.log)
    inner = _interior(len(true.time))
    lag = _lag(mended, true)
    ours = {name: np.roll(signal, lag)[inner] for name, signal in _compared(mended).items()}
    theirs, possible = ({name: one[inner] for name, one in _compared(log).items()} for log in (true, best))
    zero = float(np.median(ours["position"] - theirs["position"]))
    found = [] if abs(_sample_time(mended) / _sample_time(true) - 1.0) <= RATE else ["time"]
    for name, signal in theirs.items():
        allowed = _tolerance(name, signal, resolution)
        off = ours[name] - (zero if name in LENGTHS else 0.0)
        lost = MAX_LOSS * _rms(possible[name] - signal) if fault.undo is not None else 0.0
        untouched = fault.undo is None and _rms(ours[name] - possible[name]) <= allowed
        if not (untouched or _rms(off - signal) <= allowed + lost):
            found.append(name)
    apart = _delays(ours, theirs, zero) - _delays(possible, theirs, 0.0)
    return found if np.ptp(apart) <= MAX_SKEW else [*found, "delay between channels"]


def _delays(ours: dict[str, Signal], theirs: dict[str, Signal], zero: float) -> Signal:
    """By how many samples reference, position and command are late, by least squares; small ones only."""
    delays = []
    for name in SHIFTABLE:
        slope = np.gradient(theirs[name])
        off = ours[name] - (zero if name in LENGTHS else 0.0) - theirs[name]
        delays.append(-float(off @ slope) / max(float(slope @ slope), 1e-300))
    return np.array(delays)


def _compared(log: Log) -> dict[str, Signal]:
    """The channels but time, and the following error, to which small changes of large lengths matter."""
    return {name: signal for name, signal in log.channels.items() if name != "time"} | {ERROR: following_error(log)}


def _tolerance(name: str, signal: Signal, resolution: float) -> float:
    """RMS by which a mended channel may be off and still give the same drive."""
    if name == ERROR:
        return max(ERROR_SHARE * float(np.std(signal)), 2.0 * resolution)
    if name in LENGTHS:
        return LENGTH_SHARE * float(np.ptp(signal)) + resolution
    return COMMAND_SHARE * float(np.std(signal))


def _sample_time(log: Log) -> float:
    return float(np.median(np.diff(log.time)))


def _lag(mended: Log, true: Log) -> int:
    """By how many samples all channels of the mended log are early."""
    inner = _interior(len(true.time))

    def off(lag: int) -> float:
        return sum(
            _rms((np.roll(mended.channels[name], lag) - true.channels[name])[inner])
            / max(float(np.std(true.channels[name])), 1e-300)
            for name in SHIFTABLE
        )

    return min(range(-MAX_LAG, MAX_LAG + 1), key=lambda lag: (off(lag), abs(lag)))


def _interior(count: int) -> slice:
    edge = max(2 * MAX_LAG, int(MARGIN * count))
    return slice(edge, count - edge)


def _rms(values: Signal) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
