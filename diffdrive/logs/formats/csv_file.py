"""Reads CSV and its relatives: any delimiter, decimal comma, a preamble, a unit row, comments, several encodings."""

import csv
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.csv_arrow import parse_with_arrow
from diffdrive.logs.formats.csv_dialect import Dialect, detect_dialect
from diffdrive.logs.formats.csv_halscope import complete_halscope, without_display
from diffdrive.logs.formats.csv_header import parse_header
from diffdrive.logs.formats.csv_lines import COMMENTS, TextLine, data_lines, find_table, sample_lines
from diffdrive.logs.formats.csv_rows import cell_count, complete_rows, parse_column, split_columns
from diffdrive.logs.formats.csv_unquoted import SAMPLED, refuse_unquoted_decimals
from diffdrive.logs.formats.table import Table
from diffdrive.support.resources import format_bytes, require_memory
from diffdrive.support.text_file import decode_text, detect_encoding

IN_MEMORY = 20.0  # bytes for each of the file, while its cells are texts: measured, a cell of 8 characters takes 57
_OUTER = " \n\x00"  # what may stand around a text
_CONTROL = bytes(code for code in range(32) if chr(code) not in "\t\n\r\f\x1a")  # which text does not hold
_OF_BYTES = ("utf-8", "utf-8-sig")  # encodings in which these are bytes of their own
_SIGNATURES = {
    b"PAR1": "a Parquet file; name it .parquet",
    b"MATLAB": "a MAT file; name it .mat",
    b"\x89HDF": "an HDF5 file; name it .h5, or .mat if MATLAB wrote it",
    b"TDSm": "a TDMS file; name it .tdms",
    b"\x89MCAP": "an MCAP file; name it .mcap",
    b"MDF     ": "an MDF file; name it .mf4",
    b"PK\x03\x04": "an Excel workbook or a zip archive; save its sheet as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook; save its sheet as CSV",
}


def read_csv(path: Path) -> Table:
    """The columns of a text table; raises `LogError` naming the file, the line and the column."""
    size = path.stat().st_size
    remedy = "cut it into several, or export it as Parquet"
    require_memory(LogError, f"{path}: reading {format_bytes(size)} of text", IN_MEMORY * size, remedy)
    text = _text(path, path.read_bytes())
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    if not text.strip(" \n\x00"):
        raise LogError(f"{path}: is empty; export the log again")
    try:
        return _table(path, text)
    except csv.Error as error:  # a cell beyond what the library reads
        lines = text.split("\n")
        number = max(range(len(lines)), key=lambda k: len(lines[k]))
        raise LogError(
            f"{path}: line {number + 1} has {len(lines[number])} characters, too many for one row of a table "
            f"({error}); correct or remove it"
        ) from None


def _table(path: Path, text: str) -> Table:
    lines = sample_lines(text)
    dialect = detect_dialect(lines) if lines else None
    head, start = ([], None) if dialect is None else find_table(text, dialect, SAMPLED)
    if dialect is None or start is None:
        raise LogError(
            f"{path}: has no rows of numbers, only text such as '{_first_words(text)}'; a log needs columns of numbers "
            "below one header line"
        )
    refuse_unquoted_decimals(str(path), [(line.number, line.text) for line in head], start, dialect)
    first = head[start]
    above = without_display([line.strip(" \x00") for line in text[: first.offset].split("\n")])
    # a header may itself be a comment, as numpy.savetxt writes it
    header = parse_header([line.lstrip("".join(COMMENTS) + " ") for line in above if line], dialect)
    numbers, cells, notes = _body(path, text, first, dialect)
    columns = dict(zip(header.names, cells, strict=True))
    named = {name: values for name, values in columns.items() if not _is_trailing(name, values)}
    units = {name: unit for name, unit in header.units.items() if name in named}
    named, units, more = complete_halscope(above, named, units)
    return Table(str(path), named, units, numbers, (*notes, *more), dialect.decimal, header.clocks)


def _body(path: Path, text: str, first: TextLine, dialect: Dialect) -> tuple[np.ndarray, list[np.ndarray], list[str]]:
    """The rows from the first one on: their lines' numbers, their columns, and notes.

    What Arrow refuses is read row by row, which takes ten times as long, and says what is wrong in which line.
    """
    tail = text[first.offset :]
    body = tail.strip(_OUTER)
    begin = body.rfind("\n") + 1
    last = body[begin:]
    # nobody can say whether the last number of a line without its line end is complete
    ends_complete = "\n" in tail[len(tail.rstrip(_OUTER)) :] or last.startswith(COMMENTS)
    complete = body if ends_complete and cell_count(last, dialect) == dialect.width else body[: max(0, begin - 1)]
    columns = parse_with_arrow(complete, dialect) if complete and not last.startswith(COMMENTS) else None
    if columns is not None:
        numbers = first.number + np.arange(len(columns[0]))
        _, notes = complete_rows(
            path, [(int(numbers[-1]) + 1, last)] if complete is not body else [], dialect, ends_complete
        )
        return numbers, columns, notes
    lines = [(line.number + first.number - 1, line.text) for line in data_lines(body)]
    rows, notes = complete_rows(path, lines, dialect, ends_complete)
    if not rows:
        raise LogError(f"{path}: has one row, and that is cut off; export the log again")
    cells = split_columns([line for _, line in rows], dialect)
    return np.array([number for number, _ in rows]), [parse_column(column, dialect) for column in cells], notes


def _text(path: Path, raw: bytes) -> str:
    for signature, what in _SIGNATURES.items():
        if raw.startswith(signature):
            raise LogError(f"{path}: is {what}")
    text = decode_text(raw)
    if detect_encoding(raw) in _OF_BYTES and len(raw) - len(raw.translate(None, _CONTROL)) > 0.001 * len(text):
        raise LogError(
            f"{path}: is binary, not text; if it is MAT, Parquet, HDF5, MDF, TDMS or MCAP, give it that extension, "
            "else export the log as CSV"
        )
    return text


def _first_words(text: str) -> str:
    return text.strip(_OUTER).split("\n", 1)[0].strip(_OUTER)[:60]


def _is_trailing(name: str, values: np.ndarray) -> bool:
    """A column without name and numbers is what a delimiter at the end of each line leaves."""
    return name.isdecimal() and values.dtype.kind == "O" and not any(values)
