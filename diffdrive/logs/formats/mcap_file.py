"""Reads MCAP, whose messages are JSON: columns 'topic/field', each topic with the times at which it was logged.

MCAP is a container. Messages in protobuf, ROS and other encodings need the schemas and the packages of those that wrote
them, and are named as left out.
"""

import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive.errors import LogError
from diffdrive.logs.formats.optional import first_line, quiet, require, unreadable
from diffdrive.logs.formats.recordings import Recording, table_of
from diffdrive.logs.formats.table import Table, skipped_text
from diffdrive.support.resources import format_bytes, format_count, require_memory

IN_MEMORY = 30.0  # bytes for each of JSON: as an object and as an array, measured on messages of four numbers


def read_mcap(path: Path) -> Table:
    """The JSON messages of an MCAP file; raises `LogError` if it is none, is cut off, or holds no such messages."""
    library = require("mcap.reader", path, "MCAP files")
    with quiet():
        try:
            with path.open("rb") as stream:
                reader = library.make_reader(stream, validate_crcs=True)
                summary = reader.get_summary()
                chunks = [] if summary is None else summary.chunk_indexes
                size = max(path.stat().st_size, sum(chunk.uncompressed_size for chunk in chunks))
                remedy = "cut it into several, or leave topics out"
                require_memory(LogError, f"{path}: reading {format_bytes(size)}", IN_MEMORY * size, remedy)
                return _table(path, reader)
        except LogError:
            raise
        except Exception as error:  # the libraries, of compression too, raise a dozen kinds on a damaged file
            raise unreadable(path, "MCAP", first_line(error)) from None


def _table(path: Path, reader: Any) -> Table:
    stamps: dict[str, list[int]] = {}
    fields: dict[str, dict[str, dict[int, Any]]] = {}  # of each topic: of each field, the value in each message
    skipped: dict[str, str] = {}
    for _, channel, message in reader.iter_messages(log_time_order=False):
        topic = channel.topic.strip("/") or "topic"
        if channel.message_encoding != "json":
            skipped[topic] = f"is encoded as '{channel.message_encoding}', not as JSON"
            continue
        times, columns = stamps.setdefault(topic, []), fields.setdefault(topic, {})
        for name, value in _flat(topic, json.loads(message.data)):
            columns.setdefault(name, {})[len(times)] = value
        times.append(message.log_time)
    cells = sum(len(times) * (len(fields[topic]) + 1) for topic, times in stamps.items())
    remedy = "leave fields out that are in few messages"
    require_memory(LogError, f"{path}: reading {format_count(cells)} numbers", 16.0 * cells, remedy)
    recordings = []
    for topic, times in stamps.items():
        order = np.argsort(times, kind="stable")
        kept = {}
        for name, column in fields[topic].items():
            values = _array(column, len(times))
            if isinstance(values, str):
                skipped[name] = values
            else:
                kept[name] = values[order]
        recordings.append(Recording(topic, np.array(times, dtype=np.uint64)[order].astype(np.int64), kept, "ns"))
    if not any(recording.columns for recording in recordings):
        raise LogError(
            f"{path}: holds no JSON messages with numbers ({skipped_text(skipped) or 'it is empty'}); convert it, or "
            "decode it and pass arrays to read_log"
        )
    return table_of(str(path), recordings, {}, skipped)


def _flat(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    """The fields of a message with their paths; a message may be nested as deep as JSON's own reader bears it."""
    pending: list[tuple[str, Any]] = [(path, value)]
    while pending:
        name, one = pending.pop()
        if isinstance(one, dict):
            pending += [(f"{name}/{key}", inner) for key, inner in reversed(one.items())]
        else:
            yield name, one


def _array(column: dict[int, Any], count: int) -> np.ndarray | str:
    """A field over all messages, NaN where one lacks it, or why it is no signal."""
    for value in column.values():
        if isinstance(value, list):
            return "holds a list in each message"
        if isinstance(value, str):
            return "holds text"
    if len(column) == count and all(isinstance(value, int) and abs(value) < 2**63 for value in column.values()):
        return np.fromiter(column.values(), np.int64, count)
    values = np.full(count, np.nan)
    for k, value in column.items():
        values[k] = _number(value)
    return values


def _number(value: float | None) -> float:
    try:
        return math.nan if value is None else float(value)
    except OverflowError:  # a whole number of 400 digits
        return math.nan
