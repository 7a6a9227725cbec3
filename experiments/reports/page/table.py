"""A table of a page: headings with their units, cells as a person reads them, and words apart from numbers."""

from collections.abc import Sequence
from dataclasses import dataclass

from experiments.reports.readable import DIGITS, INFINITE, Column, heading, shown

MOST_ROWS = 60  # of a table on a page: what goes beyond two screens is read as CSV
PHRASE, SENTENCE = 16, 32  # characters, from which on a cell may take two lines, or several


@dataclass(frozen=True)
class PageTable:
    """What the macro of the template draws; `left_out` rows are only in `file`."""

    caption: str
    headings: Sequence[str]
    rows: Sequence[Sequence[str]]
    words: Sequence[int]  # columns of text, from 1, which are read from the left
    phrases: Sequence[int] = ()  # columns that may break, but not after each word
    wide: Sequence[int] = ()  # columns of sentences, which would be a word wide on a phone
    notes: Sequence[str] = ()
    file: str = ""
    left_out: int = 0


def page_table(
    caption: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[object]],
    *,
    digits: int = DIGITS,
    infinite: str = INFINITE,
    notes: Sequence[str] = (),
    file: str = "",
    most: int = MOST_ROWS,
) -> PageTable:
    """A table from the values that a report has; its first rows, where there are more than `most`."""
    kept = rows[:most] if len(rows) > most else rows
    cells = [[shown(value, digits, infinite) for value in row] for row in kept]
    named = [heading(name) for name in columns]
    drawn = [Column(*name, [row[k] for row in cells], infinite) for k, name in enumerate(named)]
    words = [k + 1 for k, column in enumerate(drawn) if not column.numeric]
    phrases, wide = (
        [k for k in words if any(len(row[k - 1]) > length for row in cells)] for length in (PHRASE, SENTENCE)
    )
    headings = [",\N{NO-BREAK SPACE}".join(part for part in one if part) for one in named]  # no unit alone in a line
    return PageTable(caption, headings, cells, words or [1], phrases, wide, notes, file, len(rows) - len(kept))
