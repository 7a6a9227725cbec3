"""Reads traces of SINUMERIK Operate, saved as XML: a column is called by its signal's name in the control.

Such as '/Nck/!SD/nckServoDataActPos1stEnc64 [u1, 1]'.
A record states the signals that have changed; the others keep their values. Units are not in the file.
"""

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.optional import first_line, unreadable
from diffdrive.logs.formats.recordings import unique_names
from diffdrive.logs.formats.table import Table, is_number, skipped_note
from diffdrive.support.messages import shortened
from diffdrive.support.resources import format_bytes, require_memory

IN_MEMORY = 8.0  # bytes for each of the file: a record of one signal is some 30 characters
_NONE = float(0x7FF0000000000000)  # where the control has no value, it writes the bits of a NaN as a whole number


def read_sinumerik(path: Path) -> Table:
    """The signals of a trace; raises `LogError` if the file is no such trace, is cut off, or holds several."""
    size = path.stat().st_size
    require_memory(LogError, f"{path}: reading {format_bytes(size)} of XML", IN_MEMORY * size, "trace a shorter time")
    trace = _Trace(path)
    try:
        for event, element in ElementTree.iterparse(path, events=("start", "end")):
            if event == "start":
                trace.open(element)
            elif element.tag == "rec":
                trace.add(element.attrib)
                element.clear()
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise unreadable(path, "a trace of SINUMERIK Operate", first_line(error)) from None
    return trace.table()


class _Trace:
    """What has been read of a trace: its signals by their ids, and the values of each in each record."""

    def __init__(self, path: Path):
        self.path, self.frames = path, 0
        self.root = ""
        self.names: dict[str, str] = {}
        self.times: list[float] = []
        self.values: dict[str, list[float]] = {}

    def open(self, element: ElementTree.Element) -> None:
        """An element begins: the root, a frame of data, or a signal."""
        self.root = self.root or element.tag
        if self.root != "traceSession":
            raise LogError(
                f"{self.path}: is XML of another kind, '{shortened(self.root)}'; a trace of SINUMERIK Operate begins "
                "with 'traceSession'; export anything else as CSV"
            )
        if element.tag == "dataFrame":
            self.frames += 1
        elif element.tag == "dataSignal":
            key = element.get("id") or f"f{len(self.names) + 1}"
            self.names[key] = element.get("name") or element.get("description") or key
            self.values[key] = []

    def add(self, record: dict[str, str]) -> None:
        """One record: its time, and the signals that it states; the others as in the one before."""
        self.times.append(self._number("time", record.get("time", "")))
        for key, column in self.values.items():
            text = record.get(key)
            column.append((column[-1] if column else math.nan) if text is None else self._number(key, text))

    def table(self) -> Table:
        """The signals as columns, those that no record states left out."""
        if self.frames > 1:
            raise LogError(f"{self.path}: holds {self.frames} recordings; save each trace in a file of its own")
        if not self.times or not self.values:
            raise LogError(f"{self.path}: holds no recorded signals; save the trace with its data")
        names = dict(zip(self.values, unique_names(("", name) for name in self.names.values()), strict=True))
        columns = {"time": np.array(self.times)}
        skipped = {}
        for key, values in self.values.items():
            array = np.array(values)
            if np.isnan(array).all():
                skipped[names[key]] = "has no values"
            else:
                columns[names[key]] = array
        return Table(str(self.path), columns, {"time": "s"}, notes=skipped_note(skipped), skipped=skipped)

    def _number(self, key: str, text: str) -> float:
        text = text.strip()
        if not is_number(text, "."):
            raise LogError(
                f"{self.path}: record {len(self.times) + (key == 'time')}, '{shortened(self.names.get(key, key))}': "
                f"'{shortened(text)}' is not a number; save the trace again"
            )
        value = float(text) if text else math.nan
        return math.nan if value >= _NONE else value
