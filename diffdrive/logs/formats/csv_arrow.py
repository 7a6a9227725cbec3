"""Rows of a text table by Arrow, which parses columns at once and keeps no text of them: a tenth of the memory."""

import re

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv

from diffdrive.logs.formats.csv_dialect import Dialect
from diffdrive.logs.formats.csv_rows import parse_column
from diffdrive.logs.formats.table import MISSING

# Arrow takes 0x1F and nan(1) for numbers, and knows no comments, which `csv_rows` does not or does
_READ_OTHERWISE = ("\x00", "x", "X", "(")
_COMMENT = re.compile(r"^ *[#%]", re.MULTILINE)
# signs for a missing value that are no number to Arrow either; others make the column text, which is read as such
_ABSENT = sorted({form for word in MISSING if "inf" not in word for form in (word, word.upper(), word.title(), "NaN")})


def parse_with_arrow(body: str, dialect: Dialect) -> list[np.ndarray] | None:
    """The columns of rows of one width, or None where they are not, or hold what has to be read row by row."""
    by_spaces = dialect.delimiter == " "
    if not body.isascii() or any(sign in body for sign in _READ_OTHERWISE) or (by_spaces and '"' in body):
        return None
    if ("#" in body or "%" in body) and _COMMENT.search(body):
        return None
    count = body.count("\n") + 1
    text = pa.py_buffer((_single_spaced(body) if by_spaces else body).encode("ascii"))

    def read(**options: object) -> pa.Table:
        return pyarrow.csv.read_csv(
            pa.BufferReader(text),
            pyarrow.csv.ReadOptions(autogenerate_column_names=True),
            pyarrow.csv.ParseOptions(delimiter=dialect.delimiter),
            pyarrow.csv.ConvertOptions(
                check_utf8=False, decimal_point=dialect.decimal, null_values=_ABSENT, true_values=[], false_values=[],
                **options,
            ),
        )  # fmt: skip

    try:
        table = read()
    except pa.ArrowInvalid:
        return None
    if len(table) != count or table.num_columns != dialect.width:
        return None
    if any(pa.types.is_floating(column.type) and pc.any(pc.is_inf(column)).as_py() for column in table.columns):
        return None  # numbers of too many digits, or infinity in words
    text_names = [field.name for field in table.schema if field.type not in (pa.int64(), pa.float64())]
    columns = {name: table[name] for name in table.column_names}
    if text_names:
        text_columns = read(column_types=dict.fromkeys(text_names, pa.string()), include_columns=text_names)
        columns |= {name: text_columns[name] for name in text_names}
    return [
        parse_column(tuple(column.to_pylist()), dialect) if name in text_names else _array(column)
        for name, column in columns.items()
    ]


def _array(column: pa.ChunkedArray) -> np.ndarray:
    """A column of numbers, NaN where it has no value; `to_numpy` would import pandas, half a second for a small log."""
    if column.null_count:
        # unsafe: a counter beyond 2^53 is rounded, as it is row by row
        column = column.cast(pa.float64(), safe=False).fill_null(np.nan)
    return np.concatenate([np.from_dlpack(chunk) for chunk in column.chunks])


def _single_spaced(body: str) -> str:
    """Cells with one space between them, and none at the ends of a line."""
    body = body.replace("\t", " ")
    while "  " in body:
        body = body.replace("  ", " ")
    return body.replace("\n ", "\n").replace(" \n", "\n")
