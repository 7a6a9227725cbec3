"""Memory and disk of this machine against what a request needs, checked before anything is allocated.

The caller estimates what one sample, one lane or one worker needs. The bound is what is free, so a big request that
fits runs.
"""

import math
import shutil
from pathlib import Path

import psutil

from diffdrive.errors import DiffdriveError

_SIZES = ((1e18, "EB"), (1e15, "PB"), (1e12, "TB"), (1e9, "GB"), (1e6, "MB"), (1e3, "kB"))
# of the container around this process, where there is one (cgroup v2, v1)
_LIMITS = (
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


def memory_available() -> float:
    """Bytes that can still be allocated on this machine, or in the container around this process if that is less."""
    free = [float(psutil.virtual_memory().available)]
    for limit, used in _LIMITS:
        try:
            free.append(float(Path(limit).read_text()) - float(Path(used).read_text()))
        except (OSError, ValueError):  # no such container, or one without a limit: "max"
            continue
    return max(0.0, min(free))


def require_memory(error: type[DiffdriveError], request: str, needed: float, remedy: str) -> None:
    """Raise `error` where `request` needs more memory (`needed`, bytes) than is free."""
    free = memory_available()
    if needed > free:
        need = f"would take about {format_bytes(needed)} of memory"
        raise error(f"{request} {need}, and {format_bytes(free)} are free: {remedy}")


def require_disk(error: type[DiffdriveError], request: str, folder: Path, needed: float, remedy: str) -> None:
    """Raise `error` where `request` writes more (`needed`, bytes) than is free on the disk of `folder`."""
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise error(
            f"{request} would write about {format_bytes(needed)}, and {format_bytes(free)} of the disk are free: "
            f"{remedy}"
        )


def format_bytes(count: float) -> str:
    """A number of bytes with its prefix, such as 1.5 GB."""
    number = _float(count)
    for size, unit in _SIZES:
        if number >= size:
            return f"{number / size:.3g} {unit}"
    return f"{number:.3g} B"


def format_count(count: float) -> str:
    """A count: in full below a million, else to three digits."""
    return f"{count}" if count < 1e6 else f"{_float(count):.3g}"


def _float(value: float) -> float:
    """The value as a float; infinite for a whole number beyond its range."""
    try:
        return float(value)
    except OverflowError:
        return math.inf
