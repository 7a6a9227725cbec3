"""The lines of a text table, found in its text without a copy of each: a log of five minutes has millions."""

from collections.abc import Iterator
from itertools import islice
from typing import NamedTuple

from diffdrive.logs.formats.csv_dialect import Dialect, first_row

COMMENTS = ("#", "%")
_SPREAD = 1000  # places all over the text
_LAST = 100  # lines at its end
_FEWEST = 256  # lines that are looked at first; twice as many where the table does not begin among them


class TextLine(NamedTuple):
    """A line without outer spaces: its number from 1, and where it begins in the text."""

    number: int
    offset: int
    text: str


def data_lines(text: str) -> Iterator[TextLine]:
    """The lines that hold something and are no comments, in order."""
    number, begin = 0, 0
    while begin <= len(text):
        number, end = number + 1, text.find("\n", begin)
        end = len(text) if end < 0 else end
        if line := _stripped(text[begin:end]):
            yield TextLine(number, begin, line)
        begin = end + 1


def sample_lines(text: str) -> list[str]:
    """Lines from all over the text, and its last hundred: enough to tell how the table is written."""
    offsets = {text.rfind("\n", 0, len(text) * k // _SPREAD) + 1 for k in range(_SPREAD)}
    last: list[str] = []
    end = len(text)
    while end >= 0 and len(last) < _LAST:
        begin = text.rfind("\n", 0, end) + 1
        if line := _stripped(text[begin:end]):
            last.append(line)
            offsets.discard(begin)
        end = begin - 1
    spread = (_stripped(text[begin : _end(text, begin)]) for begin in sorted(offsets) if begin < end)
    return [*filter(None, spread), *reversed(last)]


def find_table(text: str, dialect: Dialect, following: int) -> tuple[list[TextLine], int | None]:
    """The lines down to the first row and at least so many behind it, and which of them is that row; None if none."""
    lines = data_lines(text)
    head: list[TextLine] = []
    while True:
        wanted = max(_FEWEST, len(head))
        more = list(islice(lines, wanted))
        head += more
        start = first_row([line.text for line in head], dialect)
        if len(more) < wanted or (start is not None and start + following < len(head)):
            return head, start


def _end(text: str, begin: int) -> int:
    end = text.find("\n", begin)
    return len(text) if end < 0 else end


def _stripped(line: str) -> str:
    line = line.strip(" \r\x00")
    return "" if line.startswith(COMMENTS) else line
