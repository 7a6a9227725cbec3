"""Reads recordings of HEIDENHAIN TNCscope, saved as text with the extension .sco.

Comments state a block `[CURVEn]` for each channel, with its type, axis, unit, count and cycle time in us; below
`[DATA]` stand rows of numbers that end in semicolons, of which the first column is none of the channels.
"""

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.csv_file import read_csv
from diffdrive.logs.formats.recordings import Recording, table_of, unique_names
from diffdrive.logs.formats.table import Table
from diffdrive.support.text_file import decode_text

_HEAD = 2**20  # bytes in which the comments end
_ENTRY = re.compile(r"%\s*(?P<key>\w+)\s*=\s*(?P<value>.*)")


@dataclass
class _Curve:
    """What the comments say of one channel."""

    entries: dict[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Type and axis, such as 's actual X'."""
        return " ".join(filter(None, (self.entries.get("CHANNELTYPE", ""), self.entries.get("AXISTYPE", ""))))


def read_tncscope(path: Path) -> Table:
    """The channels of a recording; raises `LogError` if the file is none, or its rows do not fit its comments."""
    curves = _curves(path)
    table = read_csv(path)
    rows = list(table.columns.values())
    if len(rows) not in (len(curves) + 1, len(curves) + 2):  # a delimiter may end the rows
        raise LogError(
            f"{path}: has {len(curves)} channels in its comments and {len(rows)} columns below '[DATA]'; save the "
            "recording again"
        )
    names = unique_names(("", curve.name or f"channel {k + 1}") for k, curve in enumerate(curves))
    recordings, units = list[Recording](), dict[str, str]()
    for name, curve, values in zip(names, curves, rows[1:], strict=False):
        count = int(_positive(path, name, curve, "COUNT", str(len(values))))
        cycle = _positive(path, name, curve, "CYCLETIME", "")
        kept = values[: min(count, len(values))]
        recordings.append(Recording(name, cycle * np.arange(len(kept)), {name: kept}, "us"))
        if unit := curve.entries.get("DIMENSION", ""):
            units[name] = unit
    joined = table_of(str(path), recordings, units, {}, table.notes)
    return Table(joined.source, joined.columns, joined.units, table.lines, joined.notes, table.decimal, joined.clocks)


def _curves(path: Path) -> list[_Curve]:
    with path.open("rb") as file:
        raw = file.read(_HEAD)
    text = decode_text(raw)
    head, mark, _ = text.partition("[DATA]")
    if not mark or "[CURVE" not in head:
        raise LogError(
            f"{path}: is no recording of TNCscope: it needs '[CURVE1]' and '[DATA]' in its first lines; save the "
            "recording as .sco, or a table as .csv"
        )
    curves: list[_Curve] = []
    for line in head.splitlines():
        if "[CURVE" in line:
            curves.append(_Curve())
        elif curves and (entry := _ENTRY.fullmatch(line.strip())):
            curves[-1].entries[entry["key"].upper()] = entry["value"].strip()
    return curves


def _positive(path: Path, name: str, curve: _Curve, key: str, otherwise: str) -> float:
    text = curve.entries.get(key, otherwise)
    try:
        value = float(text.replace(",", "."))
    except ValueError:
        value = 0.0
    if not 0.0 < value < 1e15:
        raise LogError(f"{path}: channel '{name}': {key} must be a positive number, got '{text}'; save it again")
    return value
