"""The rows of a text table one by one: which of them are complete, and what each column's cells are."""

import contextlib
import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.csv_dialect import Dialect
from diffdrive.logs.formats.table import MISSING


def complete_rows(
    path: Path, lines: list[tuple[int, str]], dialect: Dialect, ends_complete: bool
) -> tuple[list[tuple[int, str]], list[str]]:
    """The rows with as many cells as the table has columns; a last one that is or may be cut off is left out.

    `ends_complete` says whether the last line has its line end: of one without, nobody can say whether its last number
    is complete.
    """
    rows, notes = [], []
    for number, line in lines:
        count, is_last = cell_count(line, dialect), number == lines[-1][0]
        if count == dialect.width and (ends_complete or not is_last):
            rows.append((number, line))
        elif not is_last:
            raise LogError(
                f"{path}: line {number} has {count} columns, the other rows have {dialect.width}; correct this line"
            )
        elif count == dialect.width:
            notes.append(f"line {number}, the last, has no line end: its last number may be cut off; left out")
        elif line != "EOF":  # TwinCAT's end mark
            notes.append(
                f"line {number}, the last, has {count} columns, the other rows have {dialect.width}: the file is cut "
                "off there, and this line is left out; if the log was longer, copy or export it again"
            )
    return rows, notes


def cell_count(line: str, dialect: Dialect) -> int:
    """How many cells a line has."""
    if dialect.delimiter == " ":
        return len(line.split())
    return len(dialect.split(line)) if '"' in line else line.count(dialect.delimiter) + 1


def split_columns(lines: list[str], dialect: Dialect) -> Iterable[tuple[str, ...]]:
    """The table column by column."""
    if dialect.delimiter == " ":
        return zip(*map(dialect.split, lines), strict=True)
    return zip(*csv.reader(lines, delimiter=dialect.delimiter, skipinitialspace=True), strict=True)


def parse_column(cells: tuple[str, ...], dialect: Dialect) -> np.ndarray:
    """Whole numbers, numbers, or text for `Table.numbers` to judge, such as points beside decimal commas."""
    mixed = dialect.decimal == "," and any("." in cell for cell in cells)
    plain = cells if dialect.decimal == "." else [cell.replace(",", ".") for cell in cells]
    for kind in () if mixed else (np.int64, np.float64):
        with contextlib.suppress(ValueError, OverflowError):
            values = np.array(plain, dtype=kind)
            # infinite is what says so, not what has 400 digits
            if all(cells[k].strip().casefold() in MISSING for k in np.flatnonzero(np.isinf(values))):
                return values
    return np.array([cell.strip() for cell in cells], dtype=object)
