"""Reads a log of any known format: its columns, their channels and units, missing values, the clock."""

import dataclasses
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.clocks.missing import repair_missing
from diffdrive.logs.clocks.shifts import shift_channels
from diffdrive.logs.clocks.timing import on_uniform_clock, ordered_times
from diffdrive.logs.formats.registry import READERS
from diffdrive.logs.formats.table import Table
from diffdrive.logs.log import CHANNELS, Log
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.logs.select import missing_channel_error, select

if TYPE_CHECKING:
    from diffdrive.axis import Axis

TextByChannel = Mapping[str, str]


def read_table(path: str | Path) -> Table:
    """The columns of a file by its extension, as they are; raises `LogError` if it cannot be read."""
    path = Path(path)
    if path.is_dir():
        raise LogError(f"{path}: is a folder; name the log files in it")
    if path.suffix.lower() not in READERS:
        raise LogError(f"{path}: unknown extension '{path.suffix}'; known: {', '.join(READERS)}")
    try:
        if path.stat().st_size == 0:
            raise LogError(f"{path}: is empty; export the log again")
        table = READERS[path.suffix.lower()](path)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from None
    return _with_samples(table, str(path))


def read_log(
    source: object,
    axis: "Axis | None" = None,
    *,
    columns: TextByChannel | None = None,
    units: TextByChannel | None = None,
    shifts: Mapping[str, int] | None = None,
    name: str | None = None,
    mapping: ColumnMapping | None = None,
    rate: float | None = None,
) -> Log:
    """Read a log in SI units on a uniform clock; its `notes` list what was repaired.

    Which column is which channel in which unit is found by their names, or stated by the `axis` (the tables [columns],
    [units] and [shifts] of its file), or here.

    Args:
        source: A file (of any format in docs/reference/logs.md), a data frame of pandas, polars or another library, or
            a dict of arrays [n] by column.
        axis: The axis that the log is of.
        columns: The column of each channel, such as `{"position": "ActPos"}`.
        units: What one unit of a channel's column is, such as `{"position": "mm", "command": "15.96 N"}`.
        shifts: Whole samples by which to move channels that were recorded early or late.
        name: The log's; by default the file's.
        mapping: Columns, units and shifts in the place of the axis's.
        rate: Of the rows (Hz), by default that of the axis's trace: the log is checked against it, and one without a
            time takes its time from it.

    Raises:
        LogError: The log cannot be read or used: one line that names the file, the row or column, and the remedy.

    Examples:
        >>> log = read_log("lap.csv", axis, units={"position": "mm"})
        >>> log.notes

    """
    mapping = mapping or (ColumnMapping() if axis is None else axis.mapping)
    if axis is not None and mapping.sheet.is_empty:
        mapping = dataclasses.replace(mapping, sheet=axis.sheet)
    if columns or units or shifts:
        mapping = mapping.overridden(columns or {}, units or {}, shifts or {})
    rate = rate if rate is not None or axis is None else axis.log_rate
    file = Path(source) if isinstance(source, str | Path) else None
    name = name or ("log" if file is None else file.stem)
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise LogError(f"{name if file is None else source}: the rate must be positive and finite, in Hz, got {rate!r}")
    table = table_of(source, name)
    return _log_from_table(table, Path(name) if file is None else file, name, mapping, rate)


def table_of(source: object, name: str = "log") -> Table:
    """The columns of a file, a data frame or a dict of arrays, as they are; `name` is what errors call the latter."""
    return read_table(source) if isinstance(source, str | Path) else _table_from_memory(source, name)


def _table_from_memory(source: object, name: str) -> Table:
    from diffdrive.logs.formats.frame import read_frame

    return _with_samples(read_frame(source, name), name)


def _with_samples(table: Table, source: str) -> Table:
    """The table; raises `LogError` where it is empty."""
    if not table.columns or not any(len(values) for values in table.columns.values()):
        raise LogError(f"{source}: has no samples; export the log again")
    return table


def _log_from_table(table: Table, path: Path, name: str, mapping: ColumnMapping, rate: float | None) -> Log:
    """The log that a table holds."""
    signals, clock, notes = select(table, mapping)
    if "time" not in signals:
        if rate is None:
            raise missing_channel_error(table, "time")
        signals["time"] = np.arange(len(signals["position"])) / rate
        notes.append(f"no column holds the time: counted at the drive file's {rate:g} Hz")
    times, rows, more = ordered_times(table, signals["time"], clock)
    notes += more
    signals = {name: values[rows] for name, values in signals.items()} | {"time": times}
    signals, more = repair_missing(table.source, signals)
    notes += more
    signals, gaps, more = on_uniform_clock(table.source, signals, rate, clock.factor)
    notes += more
    shifts = mapping.shifts_of(path)
    if "injected" in signals and "command" in shifts:  # of which it is a part
        shifts.setdefault("injected", shifts["command"])
    signals, gaps, more = shift_channels(table.source, signals, gaps, shifts)
    if "injected" in signals:
        signals["disturbance"] = signals.get("disturbance", 0.0) + signals["injected"]
        signals["command"] = signals["command"] - signals["injected"]
        notes.append("the injected force was subtracted from the command and counted as a disturbance")
    ordered = {name: np.ascontiguousarray(signals[name]) for name in CHANNELS if name in signals}
    return Log(name, **ordered, gaps=gaps, notes=(*table.notes, *notes, *more), shifts=shifts)


def read_logs(
    sources: Iterable[object],
    axis: "Axis | None" = None,
    *,
    columns: TextByChannel | None = None,
    units: TextByChannel | None = None,
    shifts: Mapping[str, int] | None = None,
    names: Sequence[str] | None = None,
    mapping: ColumnMapping | None = None,
    rate: float | None = None,
) -> tuple[Log, ...]:
    """Read several logs of one machine, each as `read_log` does.

    Args:
        sources: Files, data frames, or dicts of arrays.
        axis: The axis that they are of.
        columns: The column of each channel, in all of them.
        units: What one unit of a channel's column is, in all of them.
        shifts: Whole samples by which to move channels; a key such as "lap2:command" is of the file, or the data
            frame, of that name alone.
        names: One for each log; by default those of the files, with the folder's where two files are called the same.
        mapping: Columns, units and shifts in the place of the axis's.
        rate: Of the rows (Hz), by default that of the axis's trace.

    Raises:
        LogError: One of them cannot be read or used, or there are not as many names as logs.

    Examples:
        >>> laps = read_logs([slow, fast], axis, columns={"position": "ActPos"}, names=["slow", "fast"])

    """
    sources = list(sources)
    if not sources:
        raise LogError("no log is named; give one or more files")
    if names is not None and len(names) != len(sources):
        raise LogError(f"{len(sources)} logs and {len(names)} names; give one for each")
    files = [Path(source) if isinstance(source, str | Path) else None for source in sources]
    by_default = [None if file else f"log{k + 1}" for k, file in enumerate(files)]
    logs = tuple(
        read_log(source, axis, columns=columns, units=units, shifts=shifts, name=name, mapping=mapping, rate=rate)
        for source, name in zip(sources, names or by_default, strict=True)
    )
    return logs if names is not None else _told_apart(files, logs)


def _told_apart(files: Sequence[Path | None], logs: Sequence[Log]) -> tuple[Log, ...]:
    """The logs, with the folder in the names of those whose files are called the same."""
    stems = [file.stem for file in files if file is not None]
    return tuple(
        dataclasses.replace(log, name=f"{file.resolve().parent.name}/{file.stem}")
        if file is not None and stems.count(file.stem) > 1
        else log
        for file, log in zip(files, logs, strict=True)
    )
