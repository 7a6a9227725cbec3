"""Reads CSV and its relatives: any delimiter, decimal comma, a preamble, a unit row, comments, several encodings."""

import contextlib
import csv
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.csv_dialect import Dialect, dialect_of, first_row
from diffdrive.logs.csv_header import header_of
from diffdrive.logs.csv_unquoted import refuse_unquoted
from diffdrive.logs.table import MISSING, Table
from diffdrive.resources import in_bytes, require_memory
from diffdrive.text_file import decoded

IN_MEMORY = 20.0  # bytes for each of the file, while its cells are texts: measured, a cell of 8 characters takes 57
_COMMENTS = ("#", "%")
_SIGNATURES = {
    b"PAR1": "a Parquet file; name it .parquet",
    b"MATLAB": "a MAT file; name it .mat",
    b"\x89HDF": "an HDF5 file; if MATLAB wrote it, name it .mat",
    b"PK\x03\x04": "an Excel workbook or a zip archive; save its sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook; save its sheet as CSV",
}


def read_csv(path: Path) -> Table:
    """The columns of a text table; raises `LogError` naming the file, the line and the column."""
    size = path.stat().st_size
    mend = "cut it into several, or export it as Parquet"
    require_memory(LogError, f"{path}: reading {in_bytes(size)} of text", IN_MEMORY * size, mend)
    text = _text(path, path.read_bytes())
    lines = [line.strip(" \r\x00") for line in text.replace("\r\n", "\n").replace("\r", "\n").split("\n")]
    if not any(lines):
        raise LogError(f"{path}: is empty; export the log again")
    try:
        return _table(path, lines)
    except csv.Error as problem:  # a cell beyond what the library reads
        number = max(range(len(lines)), key=lambda k: len(lines[k]))
        raise LogError(
            f"{path}: line {number + 1} has {len(lines[number])} characters, too many for one row of a table "
            f"({problem}); correct or remove it"
        ) from None


def _table(path: Path, lines: list[str]) -> Table:
    kept = [(k + 1, line) for k, line in enumerate(lines) if line and not line.startswith(_COMMENTS)]
    dialect = dialect_of([line for _, line in kept])
    start = None if dialect is None else first_row([line for _, line in kept], dialect)
    if dialect is None or start is None:
        raise LogError(
            f"{path}: has no rows of numbers, only text such as '{next(filter(None, lines))[:60]}'; a log needs "
            "columns of numbers below one header line"
        )
    refuse_unquoted(str(path), kept, start, dialect)
    begin = kept[start][0]
    # a header may itself be a comment, as numpy.savetxt writes it
    preamble = [line.lstrip("".join(_COMMENTS) + " ") for line in lines[: begin - 1] if line]
    header = header_of(preamble, dialect)
    rows, notes = _rows(path, kept[start:], dialect)
    cells = _cells([line for _, line in rows], dialect)
    columns = {name: _column(column, dialect) for name, column in zip(header.names, cells, strict=True)}
    named = {name: values for name, values in columns.items() if not _is_trailing(name, values)}
    units = {name: unit for name, unit in header.units.items() if name in named}
    numbers = np.array([number for number, _ in rows])
    return Table(str(path), named, units, numbers, tuple(notes), dialect.decimal, header.clocks)


def _text(path: Path, raw: bytes) -> str:
    for signature, what in _SIGNATURES.items():
        if raw.startswith(signature):
            raise LogError(f"{path}: is {what}")
    text = decoded(raw)
    strange = sum(text.count(chr(code)) for code in range(32) if chr(code) not in "\t\n\r\f\x1a")
    if strange > 0.001 * len(text):
        raise LogError(f"{path}: is no text file but binary; export the log as CSV, MAT or Parquet")
    return text


def _rows(path: Path, kept: list[tuple[int, str]], dialect: Dialect) -> tuple[list[tuple[int, str]], list[str]]:
    """The rows with as many cells as the table has columns; a last one that was cut off is left out."""
    rows, notes = [], []
    for number, line in kept:
        found = _width(line, dialect)
        if found == dialect.width:
            rows.append((number, line))
        elif number != kept[-1][0]:
            raise LogError(
                f"{path}: line {number} has {found} columns, the other rows have {dialect.width}; correct this line"
            )
        elif line != "EOF":  # TwinCAT's end mark
            notes.append(f"line {number}, the last, is cut off and was left out")
    return rows, notes


def _width(line: str, dialect: Dialect) -> int:
    if dialect.delimiter == " ":
        return len(line.split())
    return len(dialect.split(line)) if '"' in line else line.count(dialect.delimiter) + 1


def _cells(lines: list[str], dialect: Dialect) -> Iterable[tuple[str, ...]]:
    """The table column by column."""
    if dialect.delimiter == " ":
        return zip(*map(dialect.split, lines), strict=True)
    return zip(*csv.reader(lines, delimiter=dialect.delimiter, skipinitialspace=True), strict=True)


def _column(cells: tuple[str, ...], dialect: Dialect) -> np.ndarray:
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


def _is_trailing(name: str, values: np.ndarray) -> bool:
    """A column without name and numbers is what a delimiter at the end of each line leaves."""
    return name.isdecimal() and values.dtype.kind == "O" and not any(values)
