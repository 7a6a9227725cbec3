"""Channels with time stamps of their own, as TwinCAT Scope writes them: aligned with the log's time, or refused."""

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
    """The signals with each sample in the row of its own time stamp, and notes.

    `chosen` are the channels' columns; `to_si` makes the time's column seconds. Raises `LogError` for a
    clock that is not the time but for whole samples.
    """
    if not table.clocks:
        return signals, []
    common = chosen.get("time")
    if common not in table.clocks.values():  # the time is a signal like others, or counted
        common = table.clocks.get(common or chosen["position"])
        to_si = conversion("time", table.units[common], {}) if common is not None else to_si
    aligned, notes = dict(signals), []
    for channel, column in chosen.items():
        clock = table.clocks.get(column)
        if channel == "time" or common is None or clock in (None, common):
            continue
        stamps, times = _clock_seconds(table, clock, common, to_si)
        period, lead = _period(times), stamps - times
        if period is None or not np.isfinite(lead).any():  # no clock at all: the order of the time is checked later
            continue
        differs = np.abs(np.nan_to_num(lead)) > TOLERANCE * period
        if not differs.any():
            continue
        aligned_signal = _align(signals[channel], stamps, times, period)
        if aligned_signal is None:
            row = int(np.argmax(differs))
            raise LogError(
                f"{table.source}: {table.where(row)}: the {channel}'s own clock, '{clock}', is {_lead_text(lead[row])} "
                f"'{common}'{_period_text(stamps, period)}; export channels of one task and one sample time, or this "
                "one resampled"
            )
        aligned[channel] = aligned_signal
        median_lead = float(np.nanmedian(lead))
        notes.append(
            f"{channel}: its own clock, '{clock}', is {_lead_text(median_lead)} '{common}': shifted by "
            f"{abs(median_lead) / period:.0f} samples to where its stamps are"
        )
    return aligned, notes


def _period(times: Signal) -> float | None:
    steps = np.diff(times[np.isfinite(times)])
    return float(np.median(steps[steps > 0])) if (steps > 0).any() else None


def _clock_seconds(table: Table, own: str, common: str, to_si: Conversion) -> tuple[Signal, Signal]:
    """Both clocks in seconds since one instant, as a float64 would round counters of many digits."""
    own_dates, dates = parse_dates(table, own), parse_dates(table, common)
    if own_dates is not None and dates is not None:
        origin = dates[int(np.argmin(np.isnat(dates)))]
        return _seconds(own_dates - origin), _seconds(dates - origin)
    own_counts, counts = table.columns[own], table.columns[common]
    if own_counts.dtype.kind in "iu" and counts.dtype.kind in "iu":
        begin = int(counts[0])
        return to_si((own_counts - begin).astype(np.float64)), to_si((counts - begin).astype(np.float64))
    return to_si(table.numbers(own)), to_si(table.numbers(common))


def _seconds(since: np.ndarray) -> Signal:
    """Seconds of time differences in ns, NaN where there is none."""
    return np.where(np.isnat(since), np.nan, since.astype(np.int64) * 1e-9)


def _align(values: Signal, stamps: Signal, times: Signal, period: float) -> Signal | None:
    """Each value in the row whose time is its stamp, NaN where there is none.

    None where the clocks are not a constant number of whole samples apart, or stamps fall between the rows.
    """
    time_rows, stamp_rows = np.flatnonzero(np.isfinite(times)), np.flatnonzero(np.isfinite(stamps))
    lead = (stamps - times) / period
    is_whole = np.nanmax(np.abs(lead - np.rint(np.nanmedian(lead)))) <= TOLERANCE
    if not is_whole or (np.diff(times[time_rows]) <= 0).any():
        return None
    nearest = np.searchsorted(times[time_rows], stamps[stamp_rows] - 0.5 * period)
    stamp_rows, rows = stamp_rows[nearest < len(time_rows)], time_rows[nearest[nearest < len(time_rows)]]
    distance = np.abs(times[rows] - stamps[stamp_rows]) / period
    matched = distance <= 0.5  # others lie in a gap of the time, or before its start
    if not matched.any() or distance[matched].max() > TOLERANCE:
        return None
    aligned = np.full(len(times), np.nan)
    aligned[rows[matched]] = values[stamp_rows[matched]]
    return aligned


def _lead_text(seconds: float) -> str:
    return f"{1e3 * abs(seconds):.6g} ms {'ahead of' if seconds > 0 else 'behind'}"


def _period_text(stamps: Signal, period: float) -> str:
    own_period = _period(stamps)
    if own_period is None or abs(own_period / period - 1) <= TOLERANCE:
        return ""
    return f", with {1e3 * own_period:.6g} ms per row beside {1e3 * period:.6g} ms"
