"""What a request takes against what this machine has, estimated before anything is allocated.

Who knows how much one sample, one lane or one worker takes says so here; the bound is what is there, so a big request
that fits goes on.
"""

import math
import shutil
from pathlib import Path

import psutil

from diffdrive.errors import DiffdriveError

_SIZES = ((1e18, "EB"), (1e15, "PB"), (1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
_TIMES = ((365.25 * 86400.0, "years"), (86400.0, "days"), (3600.0, "h"), (60.0, "min"))
# of the container around this process, where there is one (cgroup v2, v1)
_LIMITS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def memory_available() -> float:
    """Bytes that can still be allocated on this machine, or in the container around this process if that is less."""
    left = [float(psutil.virtual_memory().available)]
    for limit, used in _LIMITS:
        try:
            left.append(float(Path(limit).read_text()) - float(Path(used).read_text()))
        except (OSError, ValueError):  # no such container, or one without a limit: "max"
            continue
    return max(0.0, min(left))


def require_memory(error: type[DiffdriveError], request: str, needed: float, remedy: str) -> None:
    """Raise `error` where `request` takes more than the memory that is there (`needed`, bytes)."""
    there = memory_available()
    if needed > there:
        takes = f"would take about {format_bytes(needed)} of memory"
        raise error(f"{request} {takes}, and {format_bytes(there)} are free: {remedy}")


def require_disk(error: type[DiffdriveError], request: str, folder: Path, needed: float, remedy: str) -> None:
    """Raise `error` where `request` writes more than there is room for on the disk of `folder` (`needed`, bytes)."""
    there = shutil.disk_usage(folder).free
    if needed > there:
        raise error(
            f"{request} would write about {format_bytes(needed)}, and {format_bytes(there)} of the disk are free: "
            f"{remedy}"
        )


def format_bytes(count: float) -> str:
    """A number of bytes as people say it."""
    return _scaled(count, _SIZES, "B")


def format_duration(seconds: float) -> str:
    """A duration as people say it."""
    return _scaled(seconds, _TIMES, "s")


def format_count(count: float) -> str:
    """A count: in full where that can be read, else by its magnitude."""
    return f"{count}" if count < 1e6 else f"{_float(count):.3g}"


def _scaled(value: float, units: tuple[tuple[float, str], ...], smallest: str) -> str:
    number = _float(value)
    for size, unit in units:
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.3g} {smallest}"


def _float(value: float) -> float:
    """Also of a whole number that no float can hold."""
    try:
        return float(value)
    except OverflowError:
        return math.inf
