"""The folder that a command writes to: one run at a time, with room held for its result, and gone if nothing comes."""

import contextlib
import errno
import os
import tempfile
from pathlib import Path

from filelock import FileLock, Timeout

from diffdrive.errors import ParameterError
from diffdrive.support.atomic_write import NO_SPACE, remove_temporary, temporary_beside

LOCK = ".diffdrive.lock"
NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP)  # of file systems that know none


class OutputFolder:
    """Makes a folder; between `open` and `close` it keeps other runs out, and room on the disk for one result file.

    The lock is the operating system's: it ends with its process, however that ends. On a file system without locks,
    as on some network drives, other runs are not kept out; no file is cut all the same.
    """

    def __init__(self, path: Path, result: str) -> None:
        """Make the folder, and see that it can be written to.

        Raises `ParameterError` that names it: before hours of work, not after them.
        """
        self.path = path
        self._lock = FileLock(path / LOCK, timeout=0, thread_local=False)  # another thread may close it
        self._result = ReservedFile(path / result)
        self._is_open = False
        if os.path.exists(path) and not os.path.isdir(path):  # a Path raises where it may not look
            raise ParameterError(f"--out {path}: is a file, not a folder; name another")
        if os.path.islink(path) and not os.path.exists(path):
            raise ParameterError(f"--out {path}: is a link to a folder that is not there; make that, or name another")
        self._made = [one for one in (path, *path.parents) if not os.path.exists(one)]  # the deepest first
        try:
            path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=path):
                pass
        except OSError as problem:
            self._unmake()
            raise self._unwritable(problem) from None

    def _unwritable(self, problem: OSError) -> ParameterError:
        return ParameterError(f"--out {self.path}: cannot be written to ({problem.strerror}); name another folder")

    def open(self, size: int) -> None:
        """Keep other runs out, remove what killed ones left half written, and hold room for a result of `size` bytes.

        Raises `ParameterError` where another run writes to the folder, `OSError` where there is no room.
        """
        try:
            self._acquire()
            self._is_open = True
            _opened.add(self)
            self._result.hold(size)
        except BaseException:
            self.close()
            raise

    def _acquire(self) -> None:
        try:
            self._lock.acquire()
            remove_temporary(self.path)  # nobody else writes here now
        except Timeout:
            raise ParameterError(
                f"--out {self.path}: another run is writing to this folder; wait until it has ended, or name another"
            ) from None
        except OSError as problem:
            if problem.errno in NO_SPACE:
                raise
            if problem.errno not in NO_LOCKS:  # it may be another user's
                raise self._unwritable(problem) from None

    def hold(self, size: int) -> None:
        """Have room for a result of `size` bytes; raises `OSError` where there is none."""
        if self._is_open:
            self._result.hold(size)

    def write_result(self, *texts: str) -> int:
        """Write the first of the texts that there is room for, and return its number; raises `OSError` for none."""
        return self._result.write(*texts)

    def close(self) -> None:
        """Let other runs in; the folders that were made go again as far as nothing is in them."""
        self._is_open = False
        self._result.discard()
        with contextlib.suppress(OSError):  # Windows removes no open file; there the lock's release removes it
            if self._lock.is_locked:
                (self.path / LOCK).unlink()
        self._lock.release()
        _opened.discard(self)
        self._unmake()

    def _unmake(self) -> None:
        """Remove the folders that were made, as far as nothing is in them."""
        for folder in self._made:
            with contextlib.suppress(OSError):  # not empty
                folder.rmdir()


_opened: set[OutputFolder] = set()  # of this process: what `os._exit` must not leave behind


def close_all() -> None:
    """Close every folder that this process has open: its end does not wait for whoever opened them."""
    for one in list(_opened):
        one.close()


class ReservedFile:
    """A file whose contents are known only at the end, and which finds room even if the disk is full by then.

    Until it is written, a temporary file of blanks beside it holds the room. On a file system that writes every change
    to a new place (btrfs, ZFS) that is no certainty.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._temporary: Path | None = None
        self._size = 0

    def hold(self, size: int) -> None:
        """Hold at least `size` bytes."""
        if self._temporary is None:
            temporary = temporary_beside(self._path)
            temporary.open("xb").close()
            self._temporary = temporary
        if size > self._size:
            with self._temporary.open("ab") as file:
                file.write(b" " * (size - self._size))
            self._size = size

    def write(self, *texts: str) -> int:
        """Make the file, in one step, of the first of the texts that there is room for, and return its number.

        Raises `OSError` where there is room for none.
        """
        self.hold(0)
        temporary = self._temporary
        assert temporary is not None
        for k, text in enumerate(texts):
            try:
                with temporary.open("r+b") as file:
                    file.write(text.encode())
                    file.truncate()
                    os.fsync(file.fileno())
                temporary.replace(self._path)
                self._temporary, self._size = None, 0
                return k
            except OSError as problem:
                if problem.errno not in NO_SPACE or k == len(texts) - 1:
                    self.discard()
                    raise
        raise ValueError("no text to write")

    def discard(self) -> None:
        """Give the room back, without a file."""
        if self._temporary is not None:
            self._temporary.unlink(missing_ok=True)
            self._temporary, self._size = None, 0
