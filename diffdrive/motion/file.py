"""A motion from a CSV file: its time, and its reference or else its position, in the units that the header says."""

import csv
import io
from pathlib import Path

import numpy as np

from diffdrive.errors import MotionError
from diffdrive.logs.column_unit import Conversion, conversion, split_unit
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.motion.builders import from_array
from diffdrive.motion.motion import Motion
from diffdrive.support.messages import quoted_names, shortened
from diffdrive.support.text_file import decode_text

# a log holds both: the reference is repeated, not the measured position
_PREFERRED = ("reference", "position")


def read_motion(path: Path) -> str:
    """The text of a motion's file."""
    try:
        return decode_text(path.read_bytes())
    except OSError as error:
        raise MotionError(f"{path}: cannot be read: {error.strerror or error}") from None


def parse_motion_table(text: str, path: str, sheet: DataSheet = NO_SHEET) -> Motion:
    """A motion from the text of a CSV file with a column time and a column reference or position; `path` names it.

    Units stand in the header as in a log's ('position [mm]'); without one a column is in SI. If both columns exist the
    reference is taken, and the motion's name says so. Raises `MotionError` for a column that is missing, duplicate, or
    in a wrong unit.
    """
    first, _, rest = text.partition("\n")
    try:
        header = next(csv.reader([first], skipinitialspace=True), [])
        if not rest.strip():  # numpy warns
            raise ValueError("no row of numbers")
        table = np.loadtxt(io.StringIO(text), delimiter=",", skiprows=1, ndmin=2)
    except (ValueError, csv.Error) as error:
        problem = shortened(str(error).partition("\n")[0], 200)
        raise MotionError(f"{path}: not a comma-separated table of numbers under one header line: {problem}") from None
    columns = {channel: _columns(header, channel, sheet) for channel in ("time", *_PREFERRED)}
    position_channel = next((channel for channel in _PREFERRED if columns[channel]), None)
    if not columns["time"] or position_channel is None or table.shape[1] != len(header):
        raise MotionError(
            f"{path}: needs a header line with the columns time and position (or reference), each with its unit unless "
            "it is s and m, such as 'time [s],position [mm]'; has "
            f"{quoted_names(header, position_channel or 'position', 'columns')}"
        )
    time, position = (
        _in_si(table, header, channel, columns[channel], path, sheet) for channel in ("time", position_channel)
    )
    name = Path(path).name
    return from_array(time, position, name=f"{name} (column reference)" if all(columns.values()) else name)


def _columns(header: list[str], channel: str, sheet: DataSheet) -> list[int]:
    return [k for k, cell in enumerate(header) if split_unit(cell, channel, sheet)[0].strip('" ').casefold() == channel]


def _in_si(
    table: np.ndarray, header: list[str], channel: str, columns: list[int], path: str, sheet: DataSheet
) -> np.ndarray:
    if len(columns) > 1:
        raise MotionError(f"{path}: has {len(columns)} columns called {channel}: leave one")
    [column] = columns
    unit = split_unit(header[column], channel, sheet)[1]
    try:
        to_si = Conversion(1.0) if unit is None else conversion(channel, unit, {}, sheet)
    except ValueError as problem:
        raise MotionError(f"{path}: column '{header[column].strip()}': {problem}") from None
    return to_si(table[:, column])
