"""Disks that fill up: a real one of a few pages where one can be mounted, and one that is imagined, anywhere."""

import contextlib
import errno
import io
import os
import pathlib
import subprocess

import pytest

PAGE = 4096


@contextlib.contextmanager
def mounted_disk(folder, pages):
    """A disk of so many pages at `folder`; skips the test where none can be mounted."""
    folder.mkdir(exist_ok=True)
    try:
        made = subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={pages * PAGE}", "tmpfs", folder], capture_output=True, text=True
        )
    except OSError as problem:
        pytest.skip(f"no small disk can be mounted here: {problem}")
    if made.returncode:
        pytest.skip(f"no small disk can be mounted here: {made.stderr.strip()}")
    try:
        yield folder
    finally:
        # lazily: whatever else looks at the machine's files at this moment keeps a disk busy
        subprocess.run(["umount", "--lazy", folder], check=True)


class _Limited(io.FileIO):
    """A file on a disk on which `room[0]` bytes are left."""

    def __init__(self, path, mode, room):
        super().__init__(path, mode)
        self.room = room

    def write(self, data):
        data = memoryview(data).cast("B")
        grows = max(0, self.tell() + len(data) - os.fstat(self.fileno()).st_size)
        if grows > self.room[0]:
            fits = len(data) - (grows - self.room[0])
            if fits <= 0:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            data, grows = data[:fits], self.room[0]
        self.room[0] -= grows
        return super().write(data)


def simulated_disk(monkeypatch, room):
    """From here on files that are opened by their `Path` have `room` bytes together; gives those that are left."""
    left, really = [room], pathlib.Path.open

    def opened(path, mode="r", buffering=-1, encoding=None, errors=None, newline=None):
        if not set(mode) & set("wax+"):
            return really(path, mode, buffering, encoding, errors, newline)
        raw = _Limited(path, mode.replace("b", ""), left)
        file = io.BufferedRandom(raw) if "+" in mode else io.BufferedWriter(raw)
        return file if "b" in mode else io.TextIOWrapper(file, encoding, errors, newline)

    monkeypatch.setattr(pathlib.Path, "open", opened)
    return left
