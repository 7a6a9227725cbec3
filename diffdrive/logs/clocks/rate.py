"""The rate of a log beside that of the drive file: the same, a clock apart, decimated, or wrong."""

from diffdrive.errors import LogError
from diffdrive.logs.clocks.grid import UniformClock

# relative, for whoever compares rates: crystals agree far better, wrong settings far worse
RATE_TOLERANCE = 1e-3
_TOLD = 0.01  # periods of drift over the log
LARGEST_FACTOR = 50  # of decimation or oversampling
_UNITS = {"ns": 1e-9, "us": 1e-6, "ms": 1e-3, "s": 1.0, "min": 60.0}  # s


def rate_notes(source: str, grid: UniformClock, rate: float | None, unit: float = 1.0) -> list[str]:
    """Notes on how the log's rate compares with the drive file's `rate` (Hz), if that is known.

    The time stamps were read in a `unit` of so many seconds.
    Raises `LogError` where they differ by more than two clocks do, and not by a whole factor.
    """
    if rate is None:
        return []
    found = 1.0 / grid.period
    off = found / rate - 1.0
    span = float(grid.times[-1] - grid.times[0])
    if abs(off) <= RATE_TOLERANCE:
        drift = abs(off) * span
        if drift <= _TOLD * grid.period:
            return []
        return [
            f"the log's rate is {abs(off):.2g} {'below' if off < 0 else 'above'} the drive file's {rate:g} Hz by its "
            f"own stamps, {1e3 * drift:.3g} ms over the log: its own period was kept"
        ]
    ratio = max(found / rate, rate / found)
    read = next((name for name, seconds in _UNITS.items() if abs(seconds / unit - 1) < 1e-6), None)
    for name, seconds in _UNITS.items():
        if name != read and abs(seconds / unit * rate / found - 1) < 0.01:
            raise LogError(
                f"{source}: the time stamps, read in {read or f'units of {unit:g} s'}, make {found:.6g} Hz, the drive "
                f'file says {rate:g} Hz; is the time in another unit? Write [units] time = "{name}", or correct '
                "[sampling] rate"
            )
    whole = round(ratio)
    if 2 <= whole <= LARGEST_FACTOR and abs(ratio / whole - 1) <= RATE_TOLERANCE:
        what = f"every {whole}th sample of" if found < rate else f"{whole} samples in each period of"
        return [f"the log has {found:.6g} Hz: {what} the drive file's {rate:g} Hz"]
    raise LogError(
        f"{source}: the log has {found:.6g} Hz, the drive file says {rate:g} Hz; correct [sampling] rate, or the unit "
        "of the time in [units]"
    )
