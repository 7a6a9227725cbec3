"""Names and units of a text table's columns, from the lines above its numbers."""

import re
from collections import Counter
from dataclasses import dataclass, field

from diffdrive.logs.column_unit import is_unit_of, split_unit
from diffdrive.logs.formats.csv_dialect import Dialect, header_cells
from diffdrive.logs.log import CHANNELS

_LABELS = ("unit", "units", "einheit", "einheiten")  # in front of a row of units


@dataclass(frozen=True)
class Header:
    """The columns' names, each once, the units of those that have one, and the clocks where there are several."""

    names: list[str]
    units: dict[str, str]
    clocks: dict[str, str] = field(default_factory=dict)


def parse_header(preamble: list[str], dialect: Dialect) -> Header:
    """The header among the lines before the first row; columns without one are called '1', '2', ..."""
    rows = [cells for line in preamble if (cells := _cells(line, dialect)) is not None]
    scope = next((cells for cells in reversed(rows) if cells[0] == "Name"), None)
    if scope is not None:
        return _twincat(rows, scope)
    unit_row = None
    if len(rows) > 1 and _are_units(rows[-1], rows[-2]):
        unit_row = rows.pop()
    named = [name or str(k + 1) for k, name in enumerate(rows[-1])] if rows else None
    names = _unique(named or [str(k + 1) for k in range(dialect.width)])
    units = {name: unit for name, unit in zip(names, map(_bare_unit, unit_row or ()), strict=False) if unit}
    return Header(names, units)


def _cells(line: str, dialect: Dialect) -> list[str] | None:
    """The cells of a header line; a row of units may begin with a word more, which says that it is one."""
    cells = header_cells(line, dialect)
    if cells is None:
        label, *rest = line.split(None if dialect.delimiter == " " else dialect.delimiter, 1) or [""]
        cells = header_cells(rest[0] if rest else "", dialect) if label.strip('[](): "').casefold() in _LABELS else None
    return cells


def _twincat(rows: list[list[str]], names: list[str]) -> Header:
    """TwinCAT Scope: lines of pairs 'Name, X, Name, Y' and 'Unit, mm, Unit, N'; the first of a pair is its time, in ms.

    One time column may serve several signals, so a column is a time if it repeats the line's own key.
    """
    units_row = next((cells for cells in rows if cells[0] == "Unit"), [""] * len(names))
    times = [name == "Name" for name in names]
    columns, next_names = [], [*names[1:], ""]
    for k, (name, is_time) in enumerate(zip(names, times, strict=True)):
        columns.append(("time" if k == 0 else f"{next_names[k]}.clock") if is_time else name or str(k + 1))
    named = _unique(columns)
    units = {
        name: "ms" if is_time else _bare_unit(unit)
        for name, unit, is_time in zip(named, units_row, times, strict=True)
        if is_time or _bare_unit(unit)
    }
    clocks, clock = {}, ""
    for name, is_time in zip(named, times, strict=True):
        if is_time:
            clock = name
        else:
            clocks[name] = clock
    return Header(named, units, clocks)


def _bare_unit(cell: str) -> str:
    """A cell of a unit row without brackets; empty where it says that there is no unit."""
    bare = cell.strip("[]() ")
    return "" if bare in ("-", "1") or bare.casefold() == "none" else bare


def _are_units(cells: list[str], above: list[str]) -> bool:
    """Whether a row holds units, of which some may be unknown: rpm and % are no units of any channel.

    Either all are units of channels, or one is the unit of the very channel named above it, or half of them are and
    there are names above all of them.
    """
    stated = [(name, cell) for name, cell in zip(above, map(_bare_unit, cells), strict=True) if cell]
    known = sum(any(is_unit_of(channel, cell) for channel in CHANNELS) for _, cell in stated)
    if not known or known == len(stated):
        return known > 0
    if any(is_unit_of(channel, cell) for name, cell in stated for channel in CHANNELS if _is_called(name, channel)):
        return True
    named = all(re.match(r"[^\W\d]", name) or cell.casefold() in _LABELS for name, cell in stated)
    return named and known >= 2 and 2 * known >= len(stated)


def _is_called(name: str, channel: str) -> bool:
    return split_unit(name, channel)[0].strip('" ').casefold() == channel


def _unique(names: list[str]) -> list[str]:
    """Names that occur several times are numbered: nobody can say which of them is meant."""
    total, numbered = Counter(names), list[str]()
    seen: Counter[str] = Counter()
    for name in names:
        seen[name] += 1
        numbered.append(name if total[name] == 1 else f"{name}#{seen[name]}")
    return numbered
