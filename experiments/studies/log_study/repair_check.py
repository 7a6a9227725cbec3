"""Whether a repaired log equals the log without its fault."""

import numpy as np

from diffdrive.logs.log import Log, Signal
from experiments.studies.log_study.fault import COMMAND_SHARE, LogFault, following_error

LENGTHS = ("reference", "position", "motor_position")
ERROR = "following error"
# What a repaired log may be off by and still give the same drive: scales are known to 0.1 %, clocks better.
LENGTH_SHARE, ERROR_SHARE, RATE = 1e-3, 0.05, 1e-4
SHIFTABLE = ("reference", "position", "command")
MAX_SKEW = 0.1  # samples by which these may be early or late against one another: it counts as a delay of the drive
MAX_LOSS = 1.5  # times the error of the best repair, that another may leave
MAX_LAG = 8  # samples by which all channels may be moved together: that changes nothing
MARGIN = 0.02  # of the log at either end, where a shifted channel repeats its last value


def differences(repaired: Log, fault: LogFault, resolution: float) -> list[str]:
    """The channels in which the repaired log differs from the true one; empty where it does not.

    A common zero of all lengths, and a common delay of all channels, count as equal: no log has a zero of its own. What
    even `undo` cannot restore is allowed for; where nothing undoes the fault, its channel may stay as it is.
    """
    true = fault.true
    if set(repaired.channels) != set(true.channels) or len(repaired.time) != len(true.time):
        return ["channels or rows"]
    best = fault.log if fault.undo is None else fault.undo(fault.log)
    interior = _interior(len(true.time))
    lag = _lag(repaired, true)
    signals = {name: np.roll(signal, lag)[interior] for name, signal in _compared(repaired).items()}
    truth, possible = ({name: signal[interior] for name, signal in _compared(log).items()} for log in (true, best))
    offset = float(np.median(signals["position"] - truth["position"]))
    wrong = [] if abs(_sample_time(repaired) / _sample_time(true) - 1.0) <= RATE else ["time"]
    for name, signal in truth.items():
        tolerance = _tolerance(name, signal, resolution)
        shifted = signals[name] - (offset if name in LENGTHS else 0.0)
        loss = MAX_LOSS * _rms(possible[name] - signal) if fault.undo is not None else 0.0
        untouched = fault.undo is None and _rms(signals[name] - possible[name]) <= tolerance
        if not (untouched or _rms(shifted - signal) <= tolerance + loss):
            wrong.append(name)
    skew = _delays(signals, truth, offset) - _delays(possible, truth, 0.0)
    return wrong if np.ptp(skew) <= MAX_SKEW else [*wrong, "delay between channels"]


def _delays(signals: dict[str, Signal], truth: dict[str, Signal], offset: float) -> Signal:
    """By how many samples reference, position and command are late, by least squares; small ones only."""
    delays = []
    for name in SHIFTABLE:
        slope = np.gradient(truth[name])
        difference = signals[name] - (offset if name in LENGTHS else 0.0) - truth[name]
        delays.append(-float(difference @ slope) / max(float(slope @ slope), 1e-300))
    return np.array(delays)


def _compared(log: Log) -> dict[str, Signal]:
    """The channels but time, and the following error, to which small changes of large lengths matter."""
    return {name: signal for name, signal in log.channels.items() if name != "time"} | {ERROR: following_error(log)}


def _tolerance(name: str, signal: Signal, resolution: float) -> float:
    """RMS by which a repaired channel may be off and still give the same drive."""
    if name == ERROR:
        return max(ERROR_SHARE * float(np.std(signal)), 2.0 * resolution)
    if name in LENGTHS:
        return LENGTH_SHARE * float(np.ptp(signal)) + resolution
    return COMMAND_SHARE * float(np.std(signal))


def _sample_time(log: Log) -> float:
    return float(np.median(np.diff(log.time)))


def _lag(repaired: Log, true: Log) -> int:
    """By how many samples all channels of the repaired log are early."""
    interior = _interior(len(true.time))

    def mismatch(lag: int) -> float:
        return sum(
            _rms((np.roll(repaired.channels[name], lag) - true.channels[name])[interior])
            / max(float(np.std(true.channels[name])), 1e-300)
            for name in SHIFTABLE
        )

    return min(range(-MAX_LAG, MAX_LAG + 1), key=lambda lag: (mismatch(lag), abs(lag)))


def _interior(count: int) -> slice:
    edge = max(2 * MAX_LAG, int(MARGIN * count))
    return slice(edge, count - edge)


def _rms(values: Signal) -> float:
    return float(np.sqrt(np.mean(np.square(values))))
