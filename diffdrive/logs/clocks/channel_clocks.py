"""Channels with time stamps of their own, as TwinCAT Scope writes them: put onto the log's time, or refused."""

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.clocks.stamps import parse_dates
from diffdrive.logs.column_unit import Conversion, conversion
from diffdrive.logs.formats.table import Table
from diffdrive.logs.log import Signal

TOLERANCE = 0.05  # periods by which two clocks that are the same may differ: what rounding does to a stamp


def align_channel_clocks(
    table: Table, chosen: dict[str, str], signals: dict[str, Signal], to_si: Conversion
) -> tuple[dict[str, Signal], list[str]]:
    """The signals with each sample in the row that has its time, and notes; `to_si` makes the time's column seconds.

    `chosen` are the channels' columns. Raises `LogError` for a clock that is not the time but for whole samples.
    """
    if not table.clocks:
        return signals, []
    common = chosen.get("time")
    if common not in table.clocks.values():  # the time is a signal like others, or counted
        common, to_si = table.clocks.get(common or chosen["position"]), conversion("time", "ms", {})
    placed, notes = dict(signals), []
    for channel, column in chosen.items():
        own = table.clocks.get(column)
        if channel == "time" or common is None or own in (None, common):
            continue
        stamps, times = _clock_seconds(table, own, common, to_si)
        period, lead = _period(times), stamps - times
        if period is None or not np.isfinite(lead).any():  # no clock at all: the order of the time is checked later
            continue
        apart = np.abs(np.nan_to_num(lead)) > TOLERANCE * period
        if not apart.any():
            continue
        found = _align(signals[channel], stamps, times, period)
        if found is None:
            row = int(np.argmax(apart))
            raise LogError(
                f"{table.source}: {table.where(row)}: the {channel}'s own clock, '{own}', is {_lead_text(lead[row])} "
                f"'{common}'{_period_text(stamps, period)}; export channels of one task and one sample time, or this "
                "one resampled"
            )
        placed[channel] = found
        constant = float(np.nanmedian(lead))
        notes.append(
            f"{channel}: its own clock, '{own}', is {_lead_text(constant)} '{common}': moved by "
            f"{abs(constant) / period:.0f} samples to where its stamps are"
        )
    return placed, notes


def _period(times: Signal) -> float | None:
    steps = np.diff(times[np.isfinite(times)])
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else None


def _clock_seconds(table: Table, own: str, common: str, to_si: Conversion) -> tuple[Signal, Signal]:
    """Both clocks in seconds since one instant, as a float64 would round counters of many digits."""
    clocks = parse_dates(table, own), parse_dates(table, common)
    if all(clock is not None for clock in clocks):
        origin = clocks[1][int(np.argmin(np.isnat(clocks[1])))]
        since = [clock - origin for clock in clocks]
        return tuple(np.where(np.isnat(one), np.nan, one.astype(np.int64) * 1e-9) for one in since)
    columns = table.columns[own], table.columns[common]
    if all(column.dtype.kind in "iu" for column in columns):
        begin = int(columns[1][0])
        return tuple(to_si((column - begin).astype(np.float64)) for column in columns)
    return to_si(table.numbers(own)), to_si(table.numbers(common))


def _align(values: Signal, stamps: Signal, times: Signal, period: float) -> Signal | None:
    """Each value in the row whose time is its stamp, NaN where there is none.

    None where the clocks are not a constant number of whole samples apart, or stamps fall between the rows.
    """
    known, given = np.flatnonzero(np.isfinite(times)), np.flatnonzero(np.isfinite(stamps))
    lead = (stamps - times) / period
    constant = np.nanmax(np.abs(lead - np.rint(np.nanmedian(lead)))) <= TOLERANCE
    if not constant or (np.diff(times[known]) <= 0).any():
        return None
    at = np.searchsorted(times[known], stamps[given] - 0.5 * period)
    given, rows = given[at < len(known)], known[at[at < len(known)]]
    apart = np.abs(times[rows] - stamps[given]) / period
    met = apart <= 0.5  # others lie in a gap of the time, or before its start
    if not met.any() or apart[met].max() > TOLERANCE:
        return None
    placed = np.full(len(times), np.nan)
    placed[rows[met]] = values[given[met]]
    return placed


def _lead_text(seconds: float) -> str:
    return f"{1e3 * abs(seconds):.6g} ms {'ahead of' if seconds > 0 else 'behind'}"


def _period_text(stamps: Signal, period: float) -> str:
    own = _period(stamps)
    if own is None or abs(own / period - 1) <= TOLERANCE:
        return ""
    return f", with {1e3 * own:.6g} ms per row beside {1e3 * period:.6g} ms"
