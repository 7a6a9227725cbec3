"""Text tables of millions of rows: read by columns, as row by row, in a few times the memory of the file."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from diffdrive.errors import LogError
from diffdrive.logs import read_log
from diffdrive.logs.formats import csv_file
from diffdrive.logs.formats.csv_arrow import parse_with_arrow
from diffdrive.logs.formats.csv_dialect import detect_dialect
from diffdrive.logs.formats.csv_file import read_csv
from diffdrive.logs.formats.csv_rows import parse_column, split_columns
from diffdrive.logs.formats.table import Table
from tests.diffdrive.logs.test_log_formats import DIALECTS

ROWS = 40_000


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """A log of 40,000 rows as a drive writes it, with the digits that floats have."""
    path = tmp_path_factory.mktemp("long") / "log.csv"
    time = np.arange(ROWS) / 1e4
    position = np.round(0.1 * np.sin(time), 7)
    columns = (time, position, position - 1e-6 * np.cos(time), 1e3 * np.sin(7 * time))
    rows = zip(*(column.tolist() for column in columns), strict=True)
    path.write_text("time,reference,position,command\n" + "".join(f"{a!r},{b!r},{c!r},{d!r}\n" for a, b, c, d in rows))
    return path


def test_memory_is_a_few_times_the_files_size(long):
    read_log(long)  # what is imported and kept does not count
    tracemalloc.start()
    try:
        read_log(long)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 5 * long.stat().st_size


def test_no_row_of_a_plain_table_is_read_by_itself(long, monkeypatch):
    monkeypatch.setattr(csv_file, "data_lines", lambda text: pytest.fail("row by row"))
    assert len(read_csv(long).numbers("command")) == ROWS


def test_row_by_row_gives_the_same(long, monkeypatch):
    by_columns = read_csv(long)
    assert_same(by_columns, row_by_row(long, monkeypatch))
    assert by_columns.where(ROWS - 1) == f"line {ROWS + 1}"


@pytest.mark.parametrize("text", DIALECTS.values(), ids=DIALECTS.keys())
def test_every_dialect_reads_alike_by_columns_and_row_by_row(text, tmp_path, monkeypatch):
    path = tmp_path / "log.csv"
    path.write_bytes(text.encode("utf-8"))
    assert_same(read_csv(path), row_by_row(path, monkeypatch))


CELLS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(2**65), 2**65).map(str),
    st.sampled_from(
        [
            "",
            "nan",
            "NaN",
            "NA",
            "#N/A",
            "-inf",
            "+1",
            "007",
            "1_0",
            "0x1F",
            "nan(1)",
            "1d5",
            "1.",
            ".5",
            " 3 ",
            "true",
            "RUN",
            "12:00:01",
            "2024-01-01",
            "1e400",
            "1e-400",
            "Infinity",
            "-",
            "1,5",
            "%",
            "null",
            "1.#IND",
        ]
    ),
)


@example([("0.0", "9007199254740993"), ("0.0", "")], ";")  # a counter that no float holds, with a gap
@given(st.lists(st.tuples(CELLS, CELLS), min_size=1, max_size=8), st.sampled_from([";", "\t"]))
@settings(max_examples=300, deadline=None)
def test_every_cell_is_what_it_is_row_by_row(rows, delimiter):
    """As numbers or as text: a wrong cell must be named, not become another number."""
    lines = [delimiter.join([*row, "0.5"]) for row in rows]
    dialect = detect_dialect([line.strip(" ") for line in lines])
    if dialect is None or dialect.delimiter != delimiter or dialect.width != 3:
        return
    found = parse_with_arrow("\n".join(lines), dialect)
    if found is None:
        return
    expected = [parse_column(cells, dialect) for cells in split_columns(lines, dialect)]
    for one, other in zip(found, expected, strict=True):
        assert_same_column(one, other)


def test_a_file_of_comments_alone_is_no_log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("# only\n# comments\n")
    with pytest.raises(LogError, match="no rows of numbers, only text such as '# only'"):
        read_csv(path)


def row_by_row(path, monkeypatch) -> Table:
    monkeypatch.setattr(csv_file, "parse_with_arrow", lambda *_: None)
    return read_csv(path)


def assert_same(one: Table, other: Table) -> None:
    assert list(one.columns) == list(other.columns)
    assert (one.units, one.notes, one.decimal) == (other.units, other.notes, other.decimal)
    np.testing.assert_array_equal(one.lines, other.lines)
    for name in one.columns:
        assert_same_column(one.columns[name], other.columns[name])


def assert_same_column(one: np.ndarray, other: np.ndarray) -> None:
    """Equal to the last bit; numbers with gaps may be text to the one, and no values to the other."""
    if one.dtype.kind == other.dtype.kind == "O":
        assert one.tolist() == other.tolist()
        return
    numbers = [Table("log", {"column": values}).numbers("column") for values in (one, other)]
    for values in numbers:
        values[np.isinf(values)] = np.nan  # which no log is read with
    np.testing.assert_array_equal(*numbers)
