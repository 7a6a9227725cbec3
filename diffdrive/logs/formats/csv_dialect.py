"""How a text table is written: its delimiter, its decimal sign, and on which line its numbers begin."""

import csv
import re
from collections import Counter
from dataclasses import dataclass, replace

from diffdrive.logs.formats.table import GROUPED, MISSING, is_number_of_any_style

_DELIMITERS = (";", "\t", ",", " ")  # white space comes last, as others have it too
_SAMPLED = 100  # lines at the end of the file: the preamble is at its beginning
_SPREAD = 1000  # lines all over the file, for the decimal sign: at rest a log may end in whole numbers
_LAST_SIGN = re.compile(r"[.,](?!.*[.,])")


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

    def is_data(self, line: str) -> bool:
        """Whether a line is a row of the table: not a header, nor a line such as 'SampleTime[ms];2;SampleTime[ms];2'.

        One bad cell among good ones does not make a row a header, nor does a number with the other decimal sign.
        """
        cells = self.split(line)
        if len(cells) != self.width:
            return False
        numbers = [is_number_of_any_style(cells[k]) or (k > 0 and cells[k].casefold() in MISSING) for k in self.numeric]
        share = sum(numbers) / len(numbers)
        return share > 0.5 or (share == 0.5 and numbers[0])


def detect_dialect(lines: list[str]) -> Dialect | None:
    """The dialect in which most cells of the last lines are numbers, in the same columns; None if none are.

    A decimal comma before a comma as delimiter is only possible in quotes.
    """
    sample = [line for line in lines[-_SAMPLED:] if line]
    best, best_score = None, 0.0
    for delimiter in _DELIMITERS:
        candidate = Dialect(delimiter, ".", 0, ())
        rows = [candidate.split(line) for line in sample]
        [(width, count_of_width)] = Counter(map(len, rows)).most_common(1)
        if width < 2:
            continue
        counts = [sum(is_number_of_any_style(row[k]) for row in rows if len(row) == width) for k in range(width)]
        numeric = tuple(k for k, count in enumerate(counts) if count >= 0.5 * count_of_width)
        score = sum(counts) / len(rows)
        if numeric and score > best_score:
            best, best_score = Dialect(delimiter, ".", width, numeric), score
    return best and replace(best, decimal=_decimal_sign(lines, best))


def _decimal_sign(lines: list[str], dialect: Dialect) -> str:
    """The decimal sign of most numbers; those that may be thousands in groups count only where there are no others."""
    spread = (dialect.split(line) for line in lines[:: max(1, len(lines) // _SPREAD)])
    cells = [cell for row in spread if len(row) == dialect.width for cell in row if is_number_of_any_style(cell)]
    certain: Counter[str] = Counter()
    doubtful: Counter[str] = Counter()
    for cell in cells:
        if sign := _LAST_SIGN.search(cell):
            has_both = "." in cell and "," in cell  # in 1.004,5 the comma is the decimal sign for sure
            (doubtful if GROUPED.fullmatch(cell) and not has_both else certain)[sign[0]] += 1
    counts = certain or doubtful
    return "," if counts[","] > counts["."] else "."


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
    ends_empty = dialect.delimiter != " " and dialect.width - 1 not in dialect.numeric
    if len(cells) == dialect.width - 1 and ends_empty:  # rows may end in a delimiter, headers not
        cells.append("")
    return cells if len(cells) == dialect.width else None
