"""Decimal commas without quotes where the comma is the delimiter too: most numbers fall into two cells."""

import re

from diffdrive.errors import LogError
from diffdrive.logs.formats.csv_dialect import Dialect
from diffdrive.logs.formats.table import is_number_of_any_style

SAMPLED = 100  # rows below the header
_FRACTION = re.compile(r"0\d+")  # what is left behind a decimal comma, but no whole number


def refuse_unquoted_decimals(source: str, lines: list[tuple[int, str]], start: int, dialect: Dialect) -> None:
    """Raise `LogError` for rows of whole numbers, up to twice as many as the header has cells.

    `lines` are the lines of the file with their numbers, `start` is the first of them that is a row.
    """
    if dialect.delimiter != ",":
        return
    header = next((k for k in reversed(range(start)) if _is_header(lines[k][1], dialect)), None)
    if header is None:
        return
    names = len(_trimmed(lines[header][1], dialect))
    rows = [_trimmed(line, dialect) for _, line in lines[header + 1 : start + SAMPLED]][:-1]  # the last may be cut off
    numbers = [[cell for cell in row if is_number_of_any_style(cell)] for row in rows]
    width = len(_trimmed(lines[start][1], dialect))
    if not names < width <= 2 * names or any("." in cell for row in numbers for cell in row):
        return
    # a table of whole numbers below a line of prose looks alike, but its rows are of one width and without fractions
    is_evident = len({len(row) for row in rows}) > 1 or any(
        _FRACTION.fullmatch(cell) for row in numbers for cell in row
    )
    if is_evident or width == 2 * names:
        raise LogError(
            f"{source}: line {lines[start][0]} has {width} cells below the {names} names in line "
            f"{lines[header][0]}: decimal comma without quotes; export with semicolons or quotes"
        )


def _trimmed(line: str, dialect: Dialect) -> list[str]:
    """The cells of a line without those that a delimiter at its end leaves."""
    cells = dialect.split(line)
    while cells and not cells[-1]:
        cells.pop()
    return cells


def _is_header(line: str, dialect: Dialect) -> bool:
    cells = dialect.split(line)
    return len(cells) > 1 and not any(map(is_number_of_any_style, cells))
