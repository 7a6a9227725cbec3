"""Files that are complete or absent, also where the disk fills up, the process is killed, or two write the same."""

import contextlib
import errno
import os
import secrets
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

NO_SPACE = (errno.ENOSPC, errno.EDQUOT)  # no room is left
# how the names of temporary files begin and end: hidden, and with no extension of a result, so that whoever looks for
# results passes over them
PREFIX, SUFFIX = ".diffdrive-", ".tmp"


def temporary_beside(path: Path) -> Path:
    """A name beside `path` that no other write has."""
    return path.with_name(f"{PREFIX}{secrets.token_hex(8)}{SUFFIX}")


@contextlib.contextmanager
def atomic_write(path: str | Path, mode: str = "wb", *, private: bool = False) -> Iterator[IO[Any]]:
    """Yield a file to write to; `path` becomes what was written at the end of the block, in one step.

    `mode` is "wb", or "w" for text, in UTF-8 with line ends as they are written. Where the block or the disk fails,
    `path` stays as it was and nothing else is left. A link is followed. What is `private` the user alone can read.
    Raises `OSError` as `open` does.
    """
    path = Path(os.path.realpath(path))  # a replaced link would leave the file that it names as it was
    temporary = temporary_beside(path)
    encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
    temporary.touch(0o600 if private else 0o666, exist_ok=False)  # private from its first moment on
    file = temporary.open(mode, encoding=encoding, newline=newline)
    try:
        yield file
        file.flush()
        os.fsync(file.fileno())  # network drives and quotas tell only here that there is no room
        file.close()
        temporary.replace(path)
    except BaseException:
        with contextlib.suppress(OSError):  # what is still to be written finds no room either
            file.close()
        temporary.unlink(missing_ok=True)
        raise


def write_text(path: str | Path, text: str, *, private: bool = False) -> None:
    """Write a text as `atomic_write` does."""
    with atomic_write(path, "w", private=private) as file:
        file.write(text)


def remove_temporary(folder: Path) -> None:
    """Remove what writes left behind whose processes were killed; only where no other process writes to `folder`."""
    for path in folder.glob(f"{PREFIX}*{SUFFIX}"):
        path.unlink(missing_ok=True)
