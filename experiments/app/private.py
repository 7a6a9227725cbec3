"""Files that their user alone can read, such as keys. On Windows the folder of a user is private by itself."""

import contextlib
import os
import secrets
import stat
from pathlib import Path

from diffdrive.support.atomic_write import write_text

OTHERS = stat.S_IRWXG | stat.S_IRWXO  # what group and others may do


def is_private(path: Path) -> bool:
    """Whether it is a file of this user, and of nobody else; a link is none."""
    try:
        found = path.lstat()
    except OSError:
        return False
    if not stat.S_ISREG(found.st_mode):
        return False
    return os.name == "nt" or (found.st_uid == os.geteuid() and not found.st_mode & OTHERS)


def write_private(path: Path, text: str) -> None:
    """Write a text in one step; at no moment can others read it. A link is replaced, not followed."""
    if path.is_symlink():
        path.unlink()
    write_text(path, text, private=True)


def user_secret() -> bytes:
    """What this user's apps know on this machine, and no folder holds; made once.

    Where it cannot be kept, it is that of this process.
    """
    import platformdirs

    path = Path(platformdirs.user_state_dir("diffdrive", appauthor=False)) / "app-secret.txt"
    made = secrets.token_urlsafe(32)
    with contextlib.suppress(OSError, UnicodeDecodeError):
        if not is_private(path) or len(path.read_bytes()) < len(made):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_private(path, made)
        return path.read_bytes()  # that of another app, if both have made one
    return made.encode()
