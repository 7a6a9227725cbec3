"""The rows of a text table one by one: which of them are whole, and what each column's cells are."""

import contextlib
import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.csv_dialect import Dialect


def rows_of(path: Path, kept: list[tuple[int, str]], dialect: Dialect) -> tuple[list[tuple[int, str]], list[str]]:
    """The rows with as many cells as the table has columns; a last one that was cut off is left out."""
    rows, notes = [], []
    for number, line in kept:
        found = width_of(line, dialect)
        if found == dialect.width:
            rows.append((number, line))
        elif number != kept[-1][0]:
            raise LogError(
                f"{path}: line {number} has {found} columns, the other rows have {dialect.width}; correct this line"
            )
        elif line != "EOF":  # TwinCAT's end mark
            notes.append(f"line {number}, the last, is cut off and was left out")
    return rows, notes


def width_of(line: str, dialect: Dialect) -> int:
    """How many cells a line has."""
    if dialect.delimiter == " ":
        return len(line.split())
    return len(dialect.split(line)) if '"' in line else line.count(dialect.delimiter) + 1


def cells_of(lines: list[str], dialect: Dialect) -> Iterable[tuple[str, ...]]:
    """The table column by column."""
    if dialect.delimiter == " ":
        return zip(*map(dialect.split, lines), strict=True)
    return zip(*csv.reader(lines, delimiter=dialect.delimiter, skipinitialspace=True), strict=True)


def column_of(cells: tuple[str, ...], dialect: Dialect) -> np.ndarray:
    """Whole numbers, numbers, or text for `Table.numbers` to judge, such as points beside decimal commas."""
    mixed = dialect.decimal == "," and any("." in cell for cell in cells)
    plain = cells if dialect.decimal == "." else [cell.replace(",", ".") for cell in cells]
    for kind in () if mixed else (np.int64, np.float64):
        with contextlib.suppress(ValueError, OverflowError):
            return np.array(plain, dtype=kind)
    return np.array([cell.strip() for cell in cells], dtype=object)
