"""Reads a log of any known format: its columns, their channels and units, missing values, the clock."""

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.clocks.missing import without_missing
from diffdrive.logs.clocks.shifts import shifted
from diffdrive.logs.clocks.timing import in_order, on_uniform_clock
from diffdrive.logs.formats.table import Table
from diffdrive.logs.log import CHANNELS, Log
from diffdrive.logs.mapping import Mapping
from diffdrive.logs.select import missing, select


def _csv() -> Callable[[Path], Table]:
    from diffdrive.logs.formats.csv_file import read_csv

    return read_csv


def _mat() -> Callable[[Path], Table]:
    from diffdrive.logs.formats.mat_file import read_mat

    return read_mat


def _parquet() -> Callable[[Path], Table]:
    from diffdrive.logs.formats.parquet_file import read_parquet

    return read_parquet


# each imports its library only when a file needs it: they take longer than the rest of diffdrive
READERS = {
    ".csv": _csv, ".tsv": _csv, ".txt": _csv, ".dat": _csv, ".asc": _csv, ".mat": _mat,
    ".parquet": _parquet, ".pq": _parquet,
}  # fmt: skip


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
        table = READERS[path.suffix.lower()]()(path)
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except OSError as error:
        raise LogError(f"{path}: cannot be read: {error.strerror or error}") from None
    if not table.columns or not any(len(values) for values in table.columns.values()):
        raise LogError(f"{path}: has no samples; export the log again")
    return table


def read_log(path: str | Path, mapping: Mapping | None = None, rate: float | None = None) -> Log:
    """Read a log in SI units on a uniform clock; its `notes` say what was repaired on the way.

    `mapping` says which column is which channel in which unit, `rate` (Hz) is the drive file's sampling rate: the log
    is checked against it, and a log without time takes its time from it. Raises `LogError`, one line that names the
    file, the row or column, and the mend.
    """
    if rate is not None and not (np.isfinite(rate) and rate > 0):
        raise LogError(f"{path}: the rate must be positive and finite, in Hz, got {rate!r}")
    table, mapping = read_table(path), mapping or Mapping()
    signals, clock, notes = select(table, mapping)
    if "time" not in signals:
        if rate is None:
            raise missing(table, "time")
        signals["time"] = np.arange(len(signals["position"])) / rate
        notes.append(f"no column holds the time: counted at the drive file's {rate:g} Hz")
    times, rows, said = in_order(table, signals["time"], clock)
    notes += said
    signals = {name: values[rows] for name, values in signals.items()} | {"time": times}
    signals, said = without_missing(table.source, signals)
    notes += said
    signals, gaps, said = on_uniform_clock(table.source, signals, rate, clock.factor)
    notes += said
    shifts = mapping.moves(Path(path))
    if "injected" in signals and "command" in shifts:  # of which it is a part
        shifts.setdefault("injected", shifts["command"])
    signals, gaps, said = shifted(table.source, signals, gaps, shifts)
    if "injected" in signals:
        signals["disturbance"] = signals.get("disturbance", 0.0) + signals["injected"]
        signals["command"] = signals["command"] - signals["injected"]
        notes.append("the injected force was taken off the command and counted as a disturbance")
    ordered = {name: np.ascontiguousarray(signals[name]) for name in CHANNELS if name in signals}
    return Log(Path(path).stem, **ordered, gaps=gaps, notes=(*table.notes, *notes, *said), moved=shifts)


def read_logs(
    paths: Iterable[str | Path], mapping: Mapping | None = None, rate: float | None = None
) -> tuple[Log, ...]:
    """Read several logs of one machine with the same mapping and rate (Hz)."""
    files = [Path(path) for path in paths]
    logs = [read_log(path, mapping, rate) for path in files]
    if not logs:
        raise LogError("no log is named; give one or more files")
    alike = {path.stem for path in files if sum(other.stem == path.stem for other in files) > 1}
    return tuple(
        dataclasses.replace(log, name=f"{path.resolve().parent.name}/{path.stem}") if path.stem in alike else log
        for path, log in zip(files, logs, strict=True)
    )
