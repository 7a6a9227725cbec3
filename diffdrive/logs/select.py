"""From a table's columns to channels in SI, by the mapping and by the columns' own names and units."""

import difflib
import re
from collections.abc import Callable

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.clocks.channel_clocks import align_channel_clocks
from diffdrive.logs.clocks.stamps import counts_from_first, seconds_from_text
from diffdrive.logs.column_unit import FORCES, Conversion, is_unit_of, split_unit, unit_example
from diffdrive.logs.formats.table import Table
from diffdrive.logs.log import READABLE
from diffdrive.logs.mapping import ColumnMapping
from diffdrive.model.data_sheet import DataSheet
from diffdrive.support.messages import option_text, quoted_names


def select(table: Table, mapping: ColumnMapping) -> tuple[dict[str, np.ndarray], Conversion, list[str]]:
    """The channels in SI, how the time became seconds, and notes; raises `LogError` for what is missing or ambiguous.

    The time may be absent: whether that is an error depends on whether the rate is known.
    """
    chosen = _assign_columns(table, mapping)
    if "time" not in chosen:
        _require_no_unmapped_time(table, list(chosen.values()))
    lengths = {channel: len(table.columns[column]) for channel, column in chosen.items()}
    reference = "time" if "time" in chosen else "position"
    for channel, length in lengths.items():
        if length != lengths[reference]:
            raise LogError(
                f"{table.source}: column '{chosen[channel]}' has {length} values, '{chosen[reference]}' has "
                f"{lengths[reference]}; record both at one rate, or name another column for the {channel}"
            )
    signals, notes, clock = {}, [], Conversion(1.0)
    for channel, column in chosen.items():
        to_si, more = _conversion(table, mapping, channel, column)
        notes += more
        if channel == "time":
            signals[channel], clock, more = _seconds(table, column, to_si)
            notes += more
        else:
            signals[channel] = to_si(table.numbers(column))
    signals, more = align_channel_clocks(table, chosen, signals, clock)
    return signals, clock, notes + more


def _assign_columns(table: Table, mapping: ColumnMapping) -> dict[str, str]:
    chosen = {
        channel: column_named(table, channel, column, mapping.sheet) for channel, column in mapping.columns.items()
    }
    for channel, declaration in READABLE.items():
        if channel in chosen:
            continue
        free = [column for column in table.columns if column not in chosen.values()]
        matches = _matching_columns(free, channel, channel, mapping.sheet, exact=False)
        if len(matches) > 1:
            raise LogError(
                f"{table.source}: the columns {quoted_names(matches)} may each be the {channel}; say which: [columns] "
                f'{channel} = "{matches[0]}", or {_option(channel, matches[0])}'
            )
        if matches:
            chosen[channel] = matches[0]
        elif declaration.required and channel != "time":
            raise missing_channel_error(table, channel)
    return {channel: chosen[channel] for channel in READABLE if channel in chosen}


def missing_channel_error(table: Table, channel: str) -> LogError:
    """The error for a required channel that no column is called after."""
    names = list(table.columns)
    near = difflib.get_close_matches(channel, names, n=1)
    guess = near[0] if near else "COLUMN"
    return LogError(
        f'{table.source}: no column is called "{channel}"; say which is the {READABLE[channel].meaning}, such as '
        f'[columns] {channel} = "{guess}" or {_option(channel, guess)}; the file has '
        f"{quoted_names(names, channel, 'columns')}{_skipped_hint(table, channel)}"
    )


def _skipped_hint(table: Table, wanted: str) -> str:
    """What the file holds under a name near this one that is no column, and why."""
    near = difflib.get_close_matches(wanted, list(table.skipped), n=1)
    return f"; '{near[0]}' {table.skipped[near[0]]}, which is no signal" if near else ""


def _option(channel: str, column: str) -> str:
    """The command-line option that assigns the column."""
    return option_text("column", f"{channel}={column}")


def _require_no_unmapped_time(table: Table, taken: list[str]) -> None:
    """Raise `LogError` where no column is mapped to the time but one looks like it: a wrong rate scales every speed."""
    for column in table.columns:
        unit = table.units.get(column) or split_unit(column, "time")[1]
        if column in taken or unit is None or not is_unit_of("time", unit):
            continue
        try:
            values = table.numbers(column)
        except LogError:
            continue
        if len(values) > 1 and np.all(np.diff(values) > 0):
            raise LogError(
                f"{table.source}: no column is called \"time\", but '{column}' is in a unit of time and rises "
                f'throughout: say [columns] time = "{column}", or {_option("time", column)}'
            )


def column_named(table: Table, channel: str, column: str, sheet: DataSheet) -> str:
    """The column that a mapping's text names, in full or in part; raises `LogError` for none, and for several."""
    matches = _matching_columns(list(table.columns), column, channel, sheet, exact=True)
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise LogError(
            f"{table.source}: [columns] {channel} = '{column}' fits {quoted_names(matches)}; write one of them in full"
        )
    near = difflib.get_close_matches(column, list(table.columns), n=1)
    hint = f"did you mean '{near[0]}'? " if near else ""
    leave_out = "" if READABLE[channel].required else f"; a log needs no {channel}: leave that line out"
    raise LogError(
        f"{table.source}: [columns] {channel} = '{column}': no such column; {hint}the file has "
        f"{quoted_names(list(table.columns), column, 'columns')}{_skipped_hint(table, column)}{leave_out}"
    )


def _matching_columns(columns: list[str], name: str, channel: str, sheet: DataSheet, *, exact: bool) -> list[str]:
    """The columns that the name fits best: as written, then but for case and unit, then as the end of a path."""
    wanted = name.strip().casefold()

    def names(column: str) -> set[str]:
        return {column.strip().casefold(), split_unit(column, channel, sheet)[0].casefold()}

    rules: list[Callable[[str], bool]] = [
        lambda column: exact and column == name,
        lambda column: wanted in names(column),
        lambda column: any(candidate.endswith((f".{wanted}", f"/{wanted}")) for candidate in names(column)),
        lambda column: any(wanted == re.split(r"[./]", candidate)[-1].strip('" ') for candidate in names(column)),
    ]
    for rule in rules:
        if matches := [column for column in columns if rule(column)]:
            return matches
    return []


def _conversion(table: Table, mapping: ColumnMapping, channel: str, column: str) -> tuple[Conversion, list[str]]:
    file_unit = table.units.get(column) or split_unit(column, channel, mapping.sheet)[1]
    mapped_unit = mapping.units.get(channel)
    where = f"{table.source}: column '{column}'"
    if file_unit is None:
        if mapped_unit is not None:
            return mapping.conversion(channel, mapped_unit, where), []
        if channel in FORCES and mapping.force_per:
            raise LogError(
                f"{where}: [units] has a force per volt or ampere, and nothing says whether the {channel} is in V, A "
                f'or N; write [units] {channel} = "V", "A" or "N", or give --unit {channel}=N'
            )
        return Conversion(1.0), []
    if mapped_unit is None:
        if is_unit_of(channel, file_unit, mapping.sheet):
            return mapping.conversion(channel, file_unit, where), []
        raise LogError(
            f"{where}: '{file_unit}' is no unit of the {channel}; correct the file's header, or write what one unit of "
            f"the column is, such as [units] {channel} = {unit_example(channel, mapping.sheet)}"
        )
    chosen = mapping.conversion(channel, mapped_unit, where)
    try:
        agrees = np.allclose(mapping.conversion(channel, file_unit, where), chosen, rtol=1e-12, atol=0.0)
    except LogError:
        agrees = False
    return chosen, [] if agrees else [
        f"{channel}: the file says {file_unit}, [units] says {mapped_unit}, which was taken"
    ]


def _seconds(table: Table, column: str, to_si: Conversion) -> tuple[np.ndarray, Conversion, list[str]]:
    values = table.columns[column]
    if (parsed := seconds_from_text(table, column)) is not None:
        return parsed[0], Conversion(1.0), [parsed[1]]
    if values.dtype.kind in "iu" and (counted := counts_from_first(values)) is not None:
        return to_si(counted[0]), to_si, [counted[1]]
    return to_si(table.numbers(column)), to_si, []
