"""Reads TDMS, which LabVIEW writes, by npTDMS: columns 'group/channel', the clock of a waveform from its properties."""

from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.optional import first_line, quiet, require, unreadable
from diffdrive.logs.formats.recordings import Recording, table_of
from diffdrive.logs.formats.table import Table, skipped_text
from diffdrive.support.resources import format_count, require_memory

IN_MEMORY = 40.0  # bytes for each number: as the file has it, scaled, and with the stamps of its waveform
_UNITS = ("unit_string", "NI_UnitDescription", "unit")  # properties that state a unit, as LabVIEW and DAQmx write it


def read_tdms(path: Path) -> Table:
    """The channels of a TDMS file; raises `LogError` if it is none, is cut off before its data, or holds no numbers.

    A file whose last segment is incomplete, as a crash leaves it, is read as far as it goes, and a note says so.
    """
    library = require("nptdms", path, "TDMS files")
    with quiet():
        try:
            with path.open("rb") as stream, library.TdmsFile.open(stream) as file:  # without an index beside it
                _require_memory(path, file)
                return _table(path, file)
        except LogError:
            raise
        except Exception as error:  # the library raises a dozen kinds on a damaged file
            raise unreadable(path, "TDMS", first_line(error)) from None


def _require_memory(path: Path, file: Any) -> None:
    cells = sum(len(channel) for group in file.groups() for channel in group.channels())
    remedy = "cut it into several, or leave channels out"
    require_memory(LogError, f"{path}: reading {format_count(cells)} numbers", IN_MEMORY * cells, remedy)


def _table(path: Path, file: Any) -> Table:
    channels = [(group.name, channel) for group in file.groups() for channel in group.channels()]
    starts = [start for _, channel in channels if (start := _start(channel)) is not None]
    recordings, units, skipped = list[Recording](), dict[str, str](), dict[str, str]()
    for group, channel in channels:
        name = f"{group}/{channel.name}"
        values = np.asarray(channel[:])
        if values.dtype.kind in "Mm":
            values, units[name] = values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64), "ns"
        if len(values) == 0 or values.dtype.kind not in "fiub":
            skipped[name] = "has no samples" if len(values) == 0 else _why_no_signal(values)
            continue
        times = _times(channel, len(values), min(starts, default=None))
        recordings.append(Recording(group, times, {name: values}))
        unit = next((channel.properties[key] for key in _UNITS if channel.properties.get(key)), None)
        if isinstance(unit, str):
            units[name] = unit
    if not recordings:
        raise LogError(
            f"{path}: holds no channel of numbers ({skipped_text(skipped) or 'it is empty'}); export the signals "
            "themselves as channels"
        )
    cut = ("the last segment is incomplete: the recording was cut off, and may have been longer",)
    incomplete = file.file_status.incomplete_final_segment
    return table_of(str(path), recordings, units, skipped, cut if incomplete else ())


def _why_no_signal(values: np.ndarray) -> str:
    return "holds complex numbers" if values.dtype.kind == "c" else "holds text"


def _start(channel: Any) -> np.datetime64 | None:
    """The instant at which a waveform starts; None of what is no waveform."""
    start = channel.properties.get("wf_start_time")
    return start if "wf_increment" in channel.properties and isinstance(start, np.datetime64) else None


def _times(channel: Any, count: int, first: np.datetime64 | None) -> np.ndarray | None:
    """The clock of a waveform in seconds, from the first start of any; None of a channel that is no waveform."""
    increment = channel.properties.get("wf_increment")
    if not isinstance(increment, float | int) or not increment > 0:
        return None
    start = _start(channel)
    late = 0.0 if start is None or first is None else (start - first) / np.timedelta64(1, "s")
    return (late + float(channel.properties.get("wf_start_offset", 0.0))) + np.arange(count) * float(increment)
