"""Reads MDF, v2 to v4, by asammdf: channels in their physical units, each group with its master as the clock."""

import gc
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.arrays import signals
from diffdrive.logs.formats.optional import first_line, quiet, require, unreadable
from diffdrive.logs.formats.recordings import Recording, table_of, unique_names
from diffdrive.logs.formats.table import Table, skipped_text
from diffdrive.support.messages import shortened
from diffdrive.support.resources import format_count, require_memory

IN_MEMORY = 40.0  # bytes for each number: as the file has it, converted, and with the stamps of its group
_VIRTUAL = (3, 6)  # kinds of channels that count records, and have no bytes in them
_TIME = 1  # the kind of a master that counts seconds; others count angles, distances or samples


def read_mdf(path: Path) -> Table:
    """The channels of an MDF file; raises `LogError` if it is none, is cut off, or holds no numbers.

    Conversions are applied. A channel that then holds texts is left out, and a value that the file marks as invalid is
    missing.
    """
    library = require("asammdf", path, "MDF files")
    with quiet():
        try:
            with library.MDF(path) as file:
                _require_memory(path, file)
                _require_channels_in_records(path, file)
                return _table(path, file)
        except LogError:
            raise
        except Exception as error:  # the library raises a dozen kinds on a damaged file
            problem = first_line(error)
        gc.collect()  # what it leaves of such a file complains once more where it is destroyed: here, quietly
    raise unreadable(path, "MDF", problem)


def _require_memory(path: Path, file: Any) -> None:
    cells, records = 0, 0  # numbers, and bytes of the records that hold them
    for group in file.groups:
        head = group.channel_group
        cells += int(head.cycles_nr) * len(group.channels)
        records += int(head.cycles_nr) * (int(head.samples_byte_nr) + getattr(head, "invalidation_bytes_nr", 0))
    remedy = "cut it into several, or leave channels out"
    require_memory(LogError, f"{path}: reading {format_count(cells)} numbers", IN_MEMORY * cells + records, remedy)


def _require_channels_in_records(path: Path, file: Any) -> None:
    """Raise `LogError` for a channel beyond its record, where the library would read other memory, and may crash."""
    for group in file.groups:
        for i, channel in enumerate(group.channels):
            if not _is_in_record(group, i):
                raise unreadable(path, "MDF", f"channel '{shortened(channel.name)}' lies outside of its record")


def _table(path: Path, file: Any) -> Table:
    found = [
        (group, k, i)
        for k, group in enumerate(file.groups)
        for i in range(len(group.channels))
        if i != file.masters_db.get(k)
    ]
    names = unique_names((_group_name(group, k), group.channels[i].name) for group, k, i in found)
    recordings, units, skipped = list[Recording](), dict[str, str](), dict[str, str]()
    for name, (group, k, i) in zip(names, found, strict=True):
        if not group.channel_group.cycles_nr:
            skipped[name] = "has no samples"
            continue
        channel = file.get(group=k, index=i, ignore_invalidation_bits=True)
        values = _values(channel, group.channels[i].conversion is not None)
        if isinstance(values, str):
            skipped[name] = values
            continue
        times = channel.timestamps if channel.master_metadata[1] == _TIME else None
        columns = dict(signals(name, values, len(values)))
        kept = {column: array for column, array in columns.items() if not isinstance(array, str)}
        skipped |= {column: why for column, why in columns.items() if isinstance(why, str)}
        recordings.append(Recording(_group_name(group, k), times, kept))
        units |= dict.fromkeys(kept, channel.unit) if channel.unit else {}
    if not any(recording.columns for recording in recordings):
        raise LogError(
            f"{path}: holds no channel of numbers ({skipped_text(skipped) or 'it is empty'}); export the signals "
            "themselves, not texts or raw bus frames"
        )
    return table_of(str(path), recordings, units, skipped)


def _group_name(group: Any, k: int) -> str:
    return getattr(group.channel_group, "acq_name", "") or f"group {k + 1}"


def _is_in_record(group: Any, i: int) -> bool:
    """Whether the bits of a channel lie in the record of its group."""
    channel, record = group.channels[i], group.channel_group.samples_byte_nr
    if hasattr(channel, "start_offset"):  # v2 and v3
        end = 8 * channel.additional_byte_offset + channel.start_offset + channel.bit_count
    elif channel.channel_type in _VIRTUAL:
        return True
    else:
        end = 8 * channel.byte_offset + channel.bit_offset + channel.bit_count
    return end <= 8 * (record + getattr(group.channel_group, "invalidation_bytes_nr", 0))


def _values(channel: Any, is_converted: bool) -> np.ndarray | str:
    """The values of a channel in its unit, NaN where they are invalid, or why it is no signal."""
    values = np.asarray(channel.samples)
    if values.dtype.names:
        return "holds a structure in each row"
    if values.dtype.kind not in "fiub":
        return "is converted to texts" if is_converted else "holds texts"
    if values.ndim > 2:
        return f"has {values.ndim} dimensions"
    invalid = channel.invalidation_bits
    if invalid is None or not np.any(invalid):
        return values
    return np.where(np.asarray(invalid, bool).reshape(-1, *[1] * (values.ndim - 1)), np.nan, values)
