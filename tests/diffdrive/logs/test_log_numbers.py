"""Decimal signs and thousands separators in text logs: one style is read exactly, two are never read as one."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from diffdrive.errors import LogError
from diffdrive.logs import read_log
from diffdrive.logs.read import read_table

FORMATS = ["{!r}", "{:.3f}", "{:.6f}", "{:g}", "{:.3e}"]
STYLES = [(";", ","), (";", "."), ("\t", ","), ("\t", "."), (",", "."), ('","', ",")]
numbers = st.floats(-1e7, 1e7).map(lambda value: round(value, 4))


def text_of(cells: list[list[str]], delimiter: str, decimal: str) -> str:
    """A table of cells that are written with decimal points, in another style."""
    quote = '"' if '"' in delimiter else ""
    lines = [quote + delimiter.join(cell.replace(".", decimal) for cell in row) + quote for row in cells]
    return "\n".join(["a" + (delimiter if not quote else ",") + "b", *lines, ""])


@given(
    values=st.lists(st.tuples(numbers, numbers), min_size=4, max_size=300),
    form=st.sampled_from(FORMATS),
    style=st.sampled_from(STYLES),
)
@settings(max_examples=150)
def test_numbers_of_one_style_are_read_exactly(values, form, style, tmp_path_factory):
    cells = [[form.format(value) for value in row] for row in values]
    path = tmp_path_factory.getbasetemp() / "one style.csv"
    path.write_text(text_of(cells, *style))
    table = read_table(path)
    for k, name in enumerate("ab"):
        np.testing.assert_array_equal(table.numbers(name), [float(row[k]) for row in cells])


@given(
    values=st.lists(st.tuples(numbers, numbers), min_size=4, max_size=60),
    whole=st.integers(1000, 10**9 - 1),
    data=st.data(),
    style=st.sampled_from(STYLES),
)
@settings(max_examples=150)
def test_thousands_of_the_other_style_are_never_decimals(values, whole, data, style, tmp_path_factory):
    """Wherever the cell with thousands is, beside decimals that cannot be thousands."""
    delimiter, decimal = style
    row = data.draw(st.integers(0, len(values) - 1))
    cells = [[f"{value:.4f}" for value in one] for one in values]
    text = text_of(cells, delimiter, decimal).splitlines()
    other = text_of([[f"{whole:,}".replace(",", "#"), "0.5"]], delimiter, decimal).splitlines()[1]
    if delimiter == "," and decimal == ".":
        other = '"' + other.replace(",", '","') + '"'
    text[row + 1] = other.replace("#", "," if decimal == "." else ".")
    path = tmp_path_factory.getbasetemp() / "two styles.csv"
    path.write_text("\n".join(text) + "\n")
    with pytest.raises(LogError, match=rf"line {row + 2}, column 'a': .*; remove the thousands separators"):
        read_table(path).numbers("a")


@pytest.mark.parametrize("rest", [10, 1000, 30_000])
def test_a_log_that_ends_at_rest_in_whole_numbers_keeps_its_decimal_comma(rest, tmp_path):
    path = tmp_path / "log.csv"
    moving = "".join(f"{k};{k / 7:.4f};{k / 3:.3f}\n" for k in range(500)).replace(".", ",")
    path.write_text("time;position;command\n" + moving + "".join(f"{k};8;9\n" for k in range(500, 500 + rest)))
    log = read_log(path)
    np.testing.assert_allclose(log.position[:500], np.arange(500) / 7, atol=1e-4)
    assert log.command[499] == 166.333


def test_cells_of_another_style_in_columns_that_are_not_used_do_no_harm(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time;position;command;build\n" + "".join(f"{k},5;{k},25;0,1;1.004\n" for k in range(20)))
    assert read_log(path).position[3] == 3.25
