"""Which column of a log's file is which channel, in which unit and time: [columns], [units] and [shifts]."""

import dataclasses
import math
from collections.abc import Mapping
from pathlib import Path, PurePath
from typing import Any, cast

from diffdrive.errors import LogError
from diffdrive.logs.column_unit import FORCE_PER, Conversion, conversion
from diffdrive.logs.log import READABLE
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.motor_units import axis_unit, to_axis_si
from diffdrive.support.messages import short_repr, suggestion


@dataclasses.dataclass(frozen=True)
class ColumnMapping:
    """Columns and units by channel; what is absent is found by name and taken in the unit that the file says, else SI.

    `columns` holds the column's name (in MAT structures its path, such as "dspace.Y.pos"), `units` the unit of one
    column unit, such as "mm", "50 nm" or "-0.1 N". `force_per_volt` (N/V) and `force_per_ampere` (N/A) turn a command
    in V or A into newtons. `shifts` shifts a channel that was recorded early or late by whole samples, positive to
    later times; what was injected into the command shifts with it. A key such as "lap2:command" is of that log alone.
    By the axis's data sheet, `sheet`, columns in units of the motor are read, such as "%" or "deg".
    Raises `LogError` for a channel or unit that does not exist, and for a shift that is no whole number.
    """

    columns: dict[str, str] = dataclasses.field(default_factory=dict)
    units: dict[str, str] = dataclasses.field(default_factory=dict)
    force_per_volt: float | None = None
    force_per_ampere: float | None = None
    shifts: dict[str, int] = dataclasses.field(default_factory=dict)
    sheet: DataSheet = NO_SHEET

    def __post_init__(self) -> None:
        for table in ("columns", "units"):
            for channel, text in getattr(self, table).items():
                known = [*READABLE, *(FORCE_PER if table == "units" else ())]
                if channel not in READABLE:
                    raise LogError(f"[{table}] {channel}: no such channel; {suggestion(channel, known)}")
                if not isinstance(text, str) or not text.strip():
                    raise LogError(
                        f"[{table}] {channel}: must be a text, such as {_EXAMPLE[table]}, got {short_repr(text)}"
                    )
        for key, electric in FORCE_PER.items():
            gain = getattr(self, key)
            if gain is not None and not (math.isfinite(gain) and gain != 0):
                raise LogError(f"[units] {key}: must be a finite number of N/{electric} other than 0, got {gain!r}")
        for key, samples in self.shifts.items():
            log, channel = log_and_channel(key)
            if ":" in key and not log:
                raise LogError(f"[shifts] {key}: names no log: write 'lap2:{channel}', or '{channel}' for all of them")
            if channel not in READABLE or channel == "time":
                known = [name for name in READABLE if name != "time"]
                raise LogError(f"[shifts] {key}: no channel that can be shifted; {suggestion(channel, known)}")
            if isinstance(samples, bool) or not isinstance(samples, int):
                raise LogError(
                    f"[shifts] {key}: must be a whole number of samples, such as -1, got {short_repr(samples)}"
                )
        for channel in self.units:
            self.conversion(channel, self.units[channel], f"[units] {channel}")
        channel_of: dict[str, str] = {}
        for channel, column in self.columns.items():
            if column in channel_of:
                raise LogError(
                    f"[columns] {channel}: '{column}' is the {channel_of[column]} already; each needs its own"
                )
            channel_of[column] = channel

    def __hash__(self) -> int:  # so that an axis can be a static argument of compiled functions
        tables = (tuple(sorted(table.items())) for table in (self.columns, self.units, self.shifts))
        return hash((*tables, self.force_per_volt, self.force_per_ampere, self.sheet))

    @property
    def force_per(self) -> dict[str, float]:
        """N per "V" and per "A", as far as they are known."""
        gains = {electric: getattr(self, key) for key, electric in FORCE_PER.items()}
        return {electric: gain for electric, gain in gains.items() if gain is not None}

    def shifts_of(self, path: Path) -> dict[str, int]:
        """Samples by which each channel of a log's file is shifted: the key that names the log most closely counts."""
        keys = [(*log_and_channel(key), samples) for key, samples in self.shifts.items()]
        matching = [entry for entry in keys if matches_log(entry[0], path)]
        return {
            channel: samples
            for _, channel, samples in sorted(matching, key=lambda entry: len(PurePath(entry[0]).parts))
        }

    def conversion(self, channel: str, unit: str, where: str) -> Conversion:
        """How a column of `channel` in `unit` becomes SI; `where` begins the `LogError` if it cannot."""
        try:
            return conversion(channel, unit, self.force_per, self.sheet)
        except ValueError as error:
            raise LogError(f"{where}: {error}") from None

    def overridden(
        self, columns: Mapping[str, str], units: Mapping[str, object], shifts: Mapping[str, int]
    ) -> "ColumnMapping":
        """The mapping with these in the place of its own; `units` may have force_per_volt and force_per_ampere, too.

        A shift of a channel in all logs replaces those in single ones. Raises `LogError` as the mapping itself.
        """
        gains: dict[str, Any] = {key: _parse_gain(key, units[key], self.sheet) for key in FORCE_PER if key in units}
        channel_units = {key: cast(str, unit) for key, unit in units.items() if key not in FORCE_PER}
        kept = {key: samples for key, samples in self.shifts.items() if log_and_channel(key)[1] not in shifts}
        # the whole is checked, not what overrides: a unit in volts may rest on the force per volt that is there already
        return dataclasses.replace(
            self, columns=self.columns | dict(columns), units=self.units | channel_units,
            shifts=kept | dict(shifts), **gains,
        )  # fmt: skip


def log_and_channel(key: str) -> tuple[str, str]:
    """The log, "" for all of them, and the channel that a key of [shifts] shifts."""
    log, _, channel = key.rpartition(":")
    return log.strip(), channel.strip()


def matches_log(log: str, path: Path) -> bool:
    """Whether "lap2", "lap2.csv" or "monday/lap2" names a log's file; "" names every one."""
    stated, file = Path(log), path.resolve()
    suffix = (stated.resolve() if stated.is_absolute() or ".." in stated.parts else stated).parts
    return any(
        candidate.parts[len(candidate.parts) - len(suffix) :] == suffix
        for candidate in (file, file.with_name(file.stem))
    )


_EXAMPLE = {"columns": '"qm"', "units": '"mm" or "50 nm"'}


def parse_mapping(
    sheet: DataSheet, columns: dict[str, object], units: dict[str, object], shifts: dict[str, object]
) -> ColumnMapping:
    """From the tables of a drive file; raises `LogError` naming the key and the remedy."""
    for name, table in (("columns", columns), ("units", units), ("shifts", shifts)):
        if not isinstance(table, dict):
            raise LogError(f"[{name}] must be a table, got {short_repr(table)}")
    # the values are checked where the mapping is made
    return ColumnMapping(sheet=sheet).overridden(cast(dict[str, str], columns), units, cast(dict[str, int], shifts))


def mapping_tables(mapping: ColumnMapping) -> dict[str, dict[str, object]]:
    """The tables of a drive file that `parse_mapping` reads back to the same mapping; none where it is empty.

    Units of the motor are written as what they are at the table, in SI.
    """
    gains = {key: getattr(mapping, key) for key in FORCE_PER if getattr(mapping, key) is not None}
    tables: dict[str, dict[str, object]] = {
        "columns": {**mapping.columns}, "units": {**_at_table(mapping), **gains}, "shifts": {**mapping.shifts},
    }  # fmt: skip
    return {name: table for name, table in tables.items() if table}


def _at_table(mapping: ColumnMapping) -> dict[str, str]:
    """The units, those of the motor in SI."""
    plain = DataSheet(kind=mapping.sheet.kind)
    units = {}
    for channel, text in mapping.units.items():
        try:
            conversion(channel, text, mapping.force_per, plain)
        except ValueError:
            factor = mapping.conversion(channel, text, f"[units] {channel}").factor
            text = f"{factor!r} {axis_unit(READABLE[channel].unit, mapping.sheet)}"
        units[channel] = text
    return units


def _parse_gain(key: str, value: object, sheet: DataSheet) -> float:
    unit = f"N/{FORCE_PER[key]}"
    if isinstance(value, str):
        try:
            if math.isfinite(gain := float(value)):
                return gain
        except ValueError:
            pass
        try:
            return to_axis_si(value, unit, sheet)
        except ValueError as error:
            raise LogError(f"[units] {key}: {error}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LogError(f"[units] {key}: must be a number in {axis_unit(unit, sheet)}, got {short_repr(value)}")
    try:
        return float(value)
    except OverflowError:
        raise LogError(f"[units] {key}: {short_repr(value)} is larger than any number of double precision") from None
