"""What a page says of a log: which file it was, to the last bit, and what it holds."""

import contextlib
import datetime
import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

from diffdrive.logs import Log
from diffdrive.logs.log import CHANNELS

DIGITS = 16  # of the SHA-256, four bits each: two files of one folder never share them by chance


def log_rows(logs: Sequence[Log], files: Sequence[Path] = ()) -> list[Mapping[str, object]]:
    """A row of a table for each log, its file included where it was one."""
    return [_row(log, files[k] if k < len(files) else None) for k, log in enumerate(logs)]


def _row(log: Log, file: Path | None) -> Mapping[str, object]:
    there = [name for name in CHANNELS if name != "time" and getattr(log, name) is not None]
    row: dict[str, object] = {
        "log": log.name, "samples": len(log.time), "rate, Hz": log.rate, "length, s": len(log.time) / log.rate,
        "gaps": len(log.gaps), "channels": " ".join(there),
    }  # fmt: skip
    if log.load is not None:
        row["largest load, N"] = float(abs(log.load).max())
    if file is not None:
        with contextlib.suppress(OSError), file.open("rb") as opened:  # read already; it may be gone by now
            changed = datetime.datetime.fromtimestamp(file.stat().st_mtime).astimezone()
            row["changed"] = changed.isoformat(sep=" ", timespec="minutes")
            row["SHA-256, begins"] = hashlib.file_digest(opened, "sha256").hexdigest()[:DIGITS]
    return row
