"""Text logs of LinuxCNC's halscope: a first line that states the sampling period, and no time.

Older versions repeat the names in each row, 'joint.0.pos-cmd +1.5 joint.0.pos-fb +1.4'; newer ones have a header.
"""

import re
from collections.abc import Iterable

import numpy as np

from diffdrive.logs.formats.recordings import unique_names

_PERIOD = re.compile(r"Sampling period is (?P<period>[1-9]\d{0,11}) n(s|Sec)", re.IGNORECASE)
_DISPLAY = re.compile(r"# (Position|Scale): ")  # of the curves on the screen, cells as many as there are columns
Columns = dict[str, np.ndarray]


def without_display(above: list[str]) -> list[str]:
    """The lines above a table without those of halscope that look like its header."""
    return [line for line in above if not _DISPLAY.match(line)] if _period(above) else above


def complete_halscope(
    above: Iterable[str], columns: Columns, units: dict[str, str]
) -> tuple[Columns, dict[str, str], list[str]]:
    """Columns with the time that the lines above them state, their units, and notes; as they are in any other file."""
    period = _period(above)
    if period is None or "time" in columns:
        return columns, units, []
    columns = _labelled(columns)
    count = len(next(iter(columns.values())))
    time = np.arange(count) * period
    return {"time": time, **columns}, units | {"time": "ns"}, [f"time is counted from the sampling period, {period} ns"]


def _period(above: Iterable[str]) -> int | None:
    """The sampling period (ns) that a line states."""
    return next((int(found["period"]) for line in above if (found := _PERIOD.fullmatch(line.strip("# ")))), None)


def _labelled(columns: Columns) -> Columns:
    """Columns named by the texts in front of them, where every other column repeats one text."""
    values = list(columns.values())
    labels, numbers = values[::2], values[1::2]
    if list(columns) != [str(k + 1) for k in range(len(values))] or not all(map(_is_label, labels)):
        return columns
    return dict(zip(unique_names(("", str(label[0])) for label in labels), numbers, strict=True))


def _is_label(values: np.ndarray) -> bool:
    return values.dtype.kind == "O" and bool(np.all(values == values[0]))
