"""The rate of a log beside that of the drive file: equal, off by clock drift, decimated, or wrong."""

from diffdrive.errors import LogError
from diffdrive.logs.clocks.uniform_clock import UniformClock
from diffdrive.support.rates import CLOCK_TOLERANCE, is_same_rate

_NOTED_DRIFT = 0.01  # periods of drift over the log
LARGEST_FACTOR = 50  # of decimation or oversampling
_UNITS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}  # s


def rate_notes(source: str, clock: UniformClock, rate: float | None, time_unit: float = 1.0) -> list[str]:
    """Notes on how the log's rate compares with the drive file's `rate` (Hz), if that is known.

    The time stamps were read in a `time_unit` of so many seconds.
    Raises `LogError` where they differ by more than clock drift, and not by a whole factor.
    """
    if rate is None:
        return []
    log_rate = 1.0 / clock.period
    error = log_rate / rate - 1.0
    duration = float(clock.times[-1] - clock.times[0])
    if is_same_rate(log_rate, rate, CLOCK_TOLERANCE):
        drift = abs(error) * duration
        if drift <= _NOTED_DRIFT * clock.period:
            return []
        return [
            f"the log's rate is {abs(error):.2g} {'below' if error < 0 else 'above'} the drive file's {rate:g} Hz by "
            f"its own stamps, {1e3 * drift:.3g} ms over the log: its own period was kept"
        ]
    ratio = max(log_rate / rate, rate / log_rate)
    read_unit = next((name for name, seconds in _UNITS.items() if abs(seconds / time_unit - 1) < 1e-6), None)
    for name, seconds in _UNITS.items():
        if name != read_unit and abs(seconds / time_unit * rate / log_rate - 1) < 0.01:
            raise LogError(
                f"{source}: the time stamps, read in {read_unit or f'units of {time_unit:g} s'}, make "
                f"{log_rate:.6g} Hz, the drive file says {rate:g} Hz; is the time in another unit? Write [units] "
                f'time = "{name}", or correct [sampling] rate'
            )
    factor = round(ratio)
    if 2 <= factor <= LARGEST_FACTOR and is_same_rate(ratio, factor, CLOCK_TOLERANCE):
        relation = f"every {factor}th sample of" if log_rate < rate else f"{factor} samples in each period of"
        return [f"the log has {log_rate:.6g} Hz: {relation} the drive file's {rate:g} Hz"]
    raise LogError(
        f"{source}: the log has {log_rate:.6g} Hz, the drive file says {rate:g} Hz; correct [sampling] rate, or the "
        "unit of the time in [units]"
    )
