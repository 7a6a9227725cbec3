"""Files that are written whole or not at all, also on a disk that fills up."""

import contextlib
import errno
from collections.abc import Iterator
from pathlib import Path

FULL = (errno.ENOSPC, errno.EDQUOT)  # no room is left


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A hidden file beside `path` to write to; it becomes `path` when all is written."""
    half = path.with_name(f".{path.name}")  # whoever reads the folder passes over it
    yield half
    half.replace(path)
