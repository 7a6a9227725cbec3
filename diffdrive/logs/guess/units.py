"""The unit that a column's header or a file states, and which channels it can be one of."""

import re
from typing import NamedTuple

from diffdrive.logs.column_unit import is_unit_of, split_unit
from diffdrive.logs.formats.table import Table
from diffdrive.model.data_sheet import DataSheet

# units of a motor, too, are recognised as such before its data sheet is known
_ANY_SHEET = DataSheet(lead=1.0, rated_torque=1.0, rated_current=1.0, torque_constant=1.0, encoder_counts=1.0)
_KINDS = ("time", "position", "velocity", "command", "current", "temperature")
# as controls write them, and the unit library does not
_ALIASES = {
    "‰": "0.1 %", "promille": "0.1 %", "°": "deg", "grad": "deg", "umdr": "rev", "u": "rev", "inc": "count",
    "incr": "count", "inkr": "count", "counts": "count", "cts": "count", "ticks": "count", "u/min": "rpm",
    "upm": "rpm", "1/min": "rpm", "sec": "s", "msec": "ms", "usec": "us", "aeff": "A", "arms": "A", "a rms": "A",
    "°/s": "deg/s",
}  # fmt: skip

# beside those that the reader of logs knows: '(%)', and 's / mm', 'Drehmoment in Nm' as DIN 461 has them
_MORE_HEADERS = (
    re.compile(r"(?P<name>.*\S)\s*\((?P<unit>[^()]*[%‰°][^()]*)\)"),
    re.compile(r"(?P<name>.*\S)(?:\s+/\s+|\s+in\s+|,\s+)(?P<unit>\S+)"),
)


class Stated(NamedTuple):
    """A column's name without its unit, the unit as it can be read, the channels it is a unit of.

    `unit` is None where none is stated, or where it cannot be read: `unread` is that text.
    """

    name: str
    unit: str | None = None
    kinds: tuple[str, ...] = ()
    unread: str | None = None


def stated_unit(table: Table, column: str) -> Stated:
    """What the file states of the unit of a column."""
    name, text = column, table.units.get(column)
    if text is None:
        for kind in _KINDS:
            name, text = split_unit(column, kind, _ANY_SHEET)
            if text is not None:
                break
    for pattern in _MORE_HEADERS if text is None else ():
        found = pattern.fullmatch(column.strip())
        if found and any(is_unit_of(kind, _readable(found["unit"]), _ANY_SHEET) for kind in _KINDS):
            name, text = found["name"], found["unit"]
            break
    if text is None or text.strip().casefold() in ("", "-", "1", "none"):
        return Stated(name)
    unit = _readable(text)
    kinds = tuple(kind for kind in _KINDS if is_unit_of(kind, unit, _ANY_SHEET))
    return Stated(name, unit, kinds) if kinds else Stated(name, unread=text.strip())


def _readable(text: str) -> str:
    return _ALIASES.get(text.strip().casefold(), text.strip())
