"""How a text table is written: its delimiter, its decimal sign, and on which line its numbers begin."""

import csv
import re
from collections import Counter
from dataclasses import dataclass

from diffdrive.logs.table import MISSING, NUMBER

# a decimal comma before a comma as delimiter is only possible in quotes; white space comes last, as others have it too
_CANDIDATES = ((";", "."), (";", ","), ("\t", "."), ("\t", ","), (",", "."), (",", ","), (" ", "."), (" ", ","))
_SAMPLED = 100  # lines at the end of the file: the preamble is at its beginning


@dataclass(frozen=True)
class Dialect:
    """Delimiter (a space stands for any white space), decimal sign, columns, and which of them hold numbers."""

    delimiter: str
    decimal: str
    width: int
    numeric: tuple[int, ...]

    def split(self, line: str) -> list[str]:
        """The cells of one line, without quotes and outer white space."""
        if self.delimiter == " ":
            return [cell.strip('"') for cell in line.split()]
        return [cell.strip() for cell in next(csv.reader([line], delimiter=self.delimiter, skipinitialspace=True), [])]

    def is_number(self, cell: str) -> bool:
        """Whether the cell is a number in this dialect; an empty one is not."""
        return NUMBER.fullmatch(self.plain(cell)) is not None

    def plain(self, cell: str) -> str:
        """The cell with a decimal point; one that holds a point beside its decimal comma is left as it is."""
        return cell.replace(",", ".") if self.decimal == "," and "." not in cell else cell

    def is_data(self, line: str) -> bool:
        """Whether a line is a row of the table: not a header, nor a line such as 'SampleTime[ms];2;SampleTime[ms];2'.

        One bad cell among good ones does not make a row a header.
        """
        cells = self.split(line)
        if len(cells) != self.width:
            return False
        numbers = [self.is_number(cells[k]) or (k > 0 and cells[k].casefold() in MISSING) for k in self.numeric]
        share = sum(numbers) / len(numbers)
        return share > 0.5 or (share == 0.5 and numbers[0])


def dialect_of(lines: list[str]) -> Dialect | None:
    """The dialect in which most cells of the last lines are numbers, in the same columns; None if none are."""
    sample = [line for line in lines[-_SAMPLED:] if line]
    best, most = None, 0.0
    for delimiter, decimal in _CANDIDATES:
        trial = Dialect(delimiter, decimal, 0, ())
        rows = [trial.split(line) for line in sample]
        [(width, alike)] = Counter(map(len, rows)).most_common(1)
        if width < 2:
            continue
        counts = [sum(trial.is_number(row[k]) for row in rows if len(row) == width) for k in range(width)]
        numeric = tuple(k for k, count in enumerate(counts) if count >= 0.5 * alike)
        score = sum(counts) / len(rows)
        if numeric and score > most:
            best, most = Dialect(delimiter, decimal, width, numeric), score
    return best


def first_row(lines: list[str], dialect: Dialect) -> int | None:
    """The first of the lines that is a row, and is followed by rows; None if there is none."""
    for k, line in enumerate(lines):
        following = lines[k + 1 : min(k + 3, len(lines) - 1)]  # the last line may be cut off
        if dialect.is_data(line) and all(map(dialect.is_data, following)):
            return k
    return None


def header_cells(line: str, dialect: Dialect) -> list[str] | None:
    """The cells of a header line, as many as the table has columns, or None."""
    if dialect.delimiter == " ":  # 'time [s]  position [mm]': a unit belongs to the word before it
        line = re.sub(r"\s+(?=[\[(])", "", line)
    cells = dialect.split(line)
    while len(cells) > dialect.width and not cells[-1]:
        cells.pop()
    if len(cells) == dialect.width - 1 and dialect.delimiter != " ":  # rows may end in a delimiter, headers not
        cells.append("")
    return cells if len(cells) == dialect.width else None
