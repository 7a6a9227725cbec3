"""Which column of a log's file is which channel, in which unit and time: [columns], [units] and [shifts]."""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePath
from typing import cast

from diffdrive.errors import LogError
from diffdrive.logs.column_unit import FORCE_PER, Conversion, conversion
from diffdrive.logs.log import READABLE
from diffdrive.support.messages import short_repr, suggestion
from diffdrive.support.units import to_si


@dataclasses.dataclass(frozen=True)
class ColumnMapping:
    """Columns and units by channel; what is absent is found by name and taken in the unit that the file says, else SI.

    `columns` holds the column's name (in MAT structures its path, such as "dspace.Y.pos"), `units` the unit of one
    column unit, such as "mm", "50 nm" or "-0.1 N". `force_per_volt` (N/V) and `force_per_ampere` (N/A) turn a command
    in V or A into newtons. `shifts` shifts a channel that was recorded early or late by whole samples, positive to
    later times; what was injected into the command shifts with it. A key such as "lap2:command" is of that log alone.
    Raises `LogError` for a channel or unit that does not exist, and for a shift that is no whole number.
    """

    columns: dict[str, str] = dataclasses.field(default_factory=dict)
    units: dict[str, str] = dataclasses.field(default_factory=dict)
    force_per_volt: float | None = None
    force_per_ampere: float | None = None
    shifts: dict[str, int] = dataclasses.field(default_factory=dict)

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
        return hash((*tables, self.force_per_volt, self.force_per_ampere))

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
            return conversion(channel, unit, self.force_per)
        except ValueError as error:
            raise LogError(f"{where}: {error}") from None

    def updated(
        self, columns: Mapping[str, str], units: Mapping[str, str], shifts: Mapping[str, int]
    ) -> "ColumnMapping":
        """The mapping with these put over its own; raises `LogError` for a channel or unit that does not exist."""
        more = parse_mapping(dict(columns), dict(units), dict(shifts))
        gains = {key: getattr(more, key) for key in FORCE_PER if key in units}
        return dataclasses.replace(
            self, columns=self.columns | more.columns, units=self.units | more.units, shifts=self.shifts | more.shifts,
            **gains,
        )  # fmt: skip

    def overridden(
        self, columns: Iterable[str] = (), units: Iterable[str] = (), shifts: Iterable[str] = ()
    ) -> "ColumnMapping":
        """The mapping with a command line's `--column reference=qg`, `--unit command=V` and `--shift command=-1`."""
        new_columns, new_units = _assignments(columns, "--column"), _assignments(units, "--unit")
        gains = {key: _parse_gain(key, new_units.pop(key), "--unit") for key in FORCE_PER if key in new_units}
        new_shifts = {key: _parse_samples(key, samples) for key, samples in _assignments(shifts, "--shift").items()}
        # a shift that the command line states for all logs replaces the file's for a single one
        kept_shifts = {
            key: samples for key, samples in self.shifts.items() if log_and_channel(key)[1] not in new_shifts
        }
        return ColumnMapping(
            self.columns | new_columns, self.units | new_units,
            gains.get("force_per_volt", self.force_per_volt), gains.get("force_per_ampere", self.force_per_ampere),
            kept_shifts | new_shifts,
        )  # fmt: skip


def log_and_channel(key: str) -> tuple[str, str]:
    """The log, "" for all of them, and the channel that a key of [shifts] shifts."""
    log, _, channel = key.rpartition(":")
    return log.strip(), channel.strip()


def matches_log(log: str, path: Path) -> bool:
    """Whether "lap2", "lap2.csv" or "monday/lap2" names a log's file; "" names every one."""
    suffix, file = PurePath(log).parts, path.resolve()
    return any(
        candidate.parts[len(candidate.parts) - len(suffix) :] == suffix
        for candidate in (file, file.with_name(file.stem))
    )


_EXAMPLE = {"columns": '"qm"', "units": '"mm" or "50 nm"'}


def parse_mapping(columns: dict[str, object], units: dict[str, object], shifts: dict[str, object]) -> ColumnMapping:
    """From the tables of a drive file; raises `LogError` naming the key and the remedy."""
    for name, table in (("columns", columns), ("units", units), ("shifts", shifts)):
        if not isinstance(table, dict):
            raise LogError(f"[{name}] must be a table, got {short_repr(table)}")
    gains = {key: _parse_gain(key, units[key], "[units]") for key in FORCE_PER if key in units}
    column_units = {key: unit for key, unit in units.items() if key not in FORCE_PER}
    # the values are checked where the mapping is made
    names, channel_units = cast(dict[str, str], dict(columns)), cast(dict[str, str], column_units)
    return ColumnMapping(
        names, channel_units, gains.get("force_per_volt"), gains.get("force_per_ampere"),
        cast(dict[str, int], dict(shifts)),
    )  # fmt: skip


def mapping_tables(mapping: ColumnMapping) -> dict[str, dict[str, object]]:
    """The tables of a drive file that `parse_mapping` reads back to the same mapping; none where it is empty."""
    gains = {key: getattr(mapping, key) for key in FORCE_PER if getattr(mapping, key) is not None}
    tables: dict[str, dict[str, object]] = {
        "columns": {**mapping.columns}, "units": {**mapping.units, **gains}, "shifts": {**mapping.shifts},
    }  # fmt: skip
    return {name: table for name, table in tables.items() if table}


def _parse_gain(key: str, value: object, where: str) -> float:
    unit = f"N/{FORCE_PER[key]}"
    if isinstance(value, str):
        try:
            if math.isfinite(gain := float(value)):
                return gain
        except ValueError:
            pass
        try:
            return to_si(value, unit)
        except ValueError as error:
            raise LogError(f"{where} {key}: {error}") from None
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise LogError(f"{where} {key}: must be a number in {unit}, got {short_repr(value)}")
    try:
        return float(value)
    except OverflowError:
        raise LogError(f"{where} {key}: {short_repr(value)} is larger than any number of double precision") from None


def _assignments(texts: Iterable[str], option: str) -> dict[str, str]:
    assignments: dict[str, str] = {}
    for text in texts:
        channel, equals, value = (part.strip() for part in _split_assignment(text, option))
        if not (channel and equals and value):
            raise LogError(f"{option} {text}: write CHANNEL=VALUE, such as {_EXAMPLE_OF[option]}")
        if channel in assignments:
            raise LogError(f"{option} {text}: {channel} is given twice")
        assignments[channel] = value
    return assignments


def _split_assignment(text: str, option: str) -> tuple[str, str, str]:
    """At the sign that is no part of a log's name, or of a unit or a column."""
    return text.rpartition("=") if option == "--shift" else text.partition("=")


def _parse_samples(channel: str, text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise LogError(f"--shift {channel}={text}: write a whole number of samples, such as {channel}=-1") from None


_EXAMPLE_OF = {"--column": "reference=qg", "--unit": "command=V", "--shift": "command=-1"}
