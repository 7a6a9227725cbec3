"""Writes a log so that `read_log` reads the same back: to the last bit, gaps as missing time stamps."""

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.log import CHANNELS, Log
from diffdrive.support.atomic_write import atomic_write

BLOCK = 65_536  # rows that are held as Python's numbers, of four times the size, at a time
Writer = Callable[[Path, dict[str, np.ndarray], dict[str, str]], None]


def write_csv(path: Path, columns: dict[str, np.ndarray], units: dict[str, str] | None = None) -> None:
    """Write columns as CSV with the shortest digits that read back the same; the header says the units given."""
    units = units or {}
    with atomic_write(path, "w") as file:
        writer = csv.writer(file)
        writer.writerow([f"{name} [{units[name]}]" if name in units else name for name in columns])
        signals = [np.asarray(values) for values in columns.values()]
        if len({len(values) for values in signals}) > 1:
            raise ValueError("columns must be equally long")
        for begin in range(0, len(signals[0]), BLOCK):
            writer.writerows(zip(*(values[begin : begin + BLOCK].tolist() for values in signals), strict=True))


def _parquet(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    from diffdrive.logs.formats.parquet_file import write_parquet

    write_parquet(path, columns, units)


def _mat(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    from diffdrive.logs.formats.mat_file import write_mat

    write_mat(path, columns, units)


def _mat73(path: Path, columns: dict[str, np.ndarray], units: dict[str, str]) -> None:
    from diffdrive.logs.formats.mat73_file import write_mat73

    write_mat73(path, columns, units)


# by the end of the name, the longer first
WRITERS: dict[str, Writer] = {".csv": write_csv, ".parquet": _parquet, ".73.mat": _mat73, ".mat": _mat}


def write_log(path: str | Path, log: Log) -> None:
    """Write a log by the path's extension, in SI units; `name` and `notes` are not kept.

    A `.mat` file is of version 5, one that ends in `.73.mat` of version 7.3.

    Raises `LogError` for an unknown extension or a folder that cannot be written to.
    """
    path = Path(path)
    write = next((write for suffix, write in WRITERS.items() if path.name.lower().endswith(suffix)), None)
    if write is None:
        raise LogError(f"{path}: cannot write '{path.suffix}'; known: {', '.join(WRITERS)}")
    columns = {name: np.asarray(values, dtype=np.float64) for name, values in log.channels.items()}
    try:
        write(path, columns, {name: CHANNELS[name].unit for name in columns})
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror or error}") from None
