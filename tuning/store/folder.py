"""Finished parts of a command's computation, in a folder, from which the same command continues when it was stopped."""

import shutil
import threading
import zipfile
from pathlib import Path

import numpy as np

from diffdrive.runtime import arithmetic_signature
from diffdrive.support.atomic_write import atomic_write, remove_temporary
from tuning.store.edition import code_digest
from tuning.store.store import Arrays, digest


class FolderStore:
    """A `Store` in a folder: one file of arrays a part, written as a whole, read back to the last bit.

    A part is found again by the same edition of the code on the same kind of processor alone: others round otherwise.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.hits = 0  # parts that were there
        self._context = digest(code_digest(), arithmetic_signature())
        self._lock = threading.Lock()
        remove_temporary(folder)  # of a run that was killed as it wrote

    @classmethod
    def in_folder(cls, out: Path | None, name: str) -> "FolderStore | None":
        """Those of that name in a command's folder; None without a folder."""
        return None if out is None else cls(out / name)

    @classmethod
    def of(cls, folder: str | Path | None) -> "FolderStore | None":
        """The one in a folder; None without a folder."""
        return None if folder is None else cls(Path(folder))

    def _path(self, key: str) -> Path:
        return self.folder / f"{digest(self._context, key)}.npz"

    def read(self, key: str) -> Arrays | None:
        """The part of that key; None where there is none, or it is damaged."""
        try:
            with self._path(key).open("rb") as file:
                part = dict(np.load(file, allow_pickle=False))
        except (OSError, ValueError, EOFError, zipfile.BadZipFile):
            return None
        with self._lock:
            self.hits += 1
        return part

    def write(self, key: str, piece: Arrays) -> None:
        """Keep a part."""
        self.folder.mkdir(parents=True, exist_ok=True)
        with atomic_write(self._path(key)) as file:
            np.savez(file, allow_pickle=True, **piece)

    def remove(self) -> None:
        """Remove all parts, once what they are parts of is written."""
        shutil.rmtree(self.folder, ignore_errors=True)
