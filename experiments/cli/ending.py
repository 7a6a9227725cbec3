"""An interrupted command ends in time, whatever it computes, and says what it leaves.

A signal's Python handler runs in the main thread, and only between two steps of the interpreter: not while that thread
is in compiled code (compilation, a long roll-out). So a thread of its own reads the signals from the wake-up socket, to
which the C handler writes at once, and ends the process where the main thread does not end it in time.
"""

import _thread
import contextlib
import itertools
import os
import select
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NoReturn

from diffdrive.support.processes import end_children
from experiments.reports.interruption import FIRST, SECOND, SIGNALS, TOGETHER
from experiments.reports.output_folder import close_all

INTERRUPTED = 130
LAST_WORDS = 0.5  # s, that a blocked pipe or disk may hold up each of the five steps of the end
# what commands continue from: diagnose, identify, compare, real-axes, tune, sweep, recovery, withheld
CONTINUED = (
    "diagnosis.parts", "identification.parts", "comparison.parts", "real-axes.parts", "tuning.checkpoint.json",
    "pareto.parts", "parts", "draws.jsonl", "answers",
)  # fmt: skip
SWALLOWED = 0  # on the wake-up socket, beside the numbers of signals
SHOW_CURSOR = b"\x1b[?25h"


class SignalWatch:
    """The signals of this process, from `begin` to `end`."""

    def __init__(self, out: Path | None = None) -> None:
        """`out` is the folder that the command writes to, for its last words."""
        self.out, self.before = out, file_stamps(out)
        self.resent = 0  # signals that were raised again here, and are still on their way
        self.raised = False
        self.received_at: float | None = None  # the first signal, as `time.monotonic` has it

    def begin(self) -> None:
        """From here on a signal interrupts the main thread, and ends the process where that does not."""
        self._here, there = socket.socketpair()
        self._there = there
        there.setblocking(False)  # the handler must never wait
        self._before = [(one, signal.signal(one, self._interrupt)) for one in SIGNALS]
        self._descriptor = signal.set_wakeup_fd(there.fileno(), warn_on_full_buffer=False)
        self._hook, sys.unraisablehook = sys.unraisablehook, self._unraisable
        threading.Thread(target=self._watch, name="signals", daemon=True).start()

    def end(self) -> None:
        """Leave the signals to whoever had them before."""
        sys.unraisablehook = self._hook
        signal.set_wakeup_fd(self._descriptor)
        for one, handler in self._before:
            signal.signal(one, handler)
        self._there.close()  # which ends the thread

    def _interrupt(self, *_: object) -> None:
        """Raised once: a second exception would break what the first one has set going, the writing of results."""
        if not self.raised:
            self.raised = True
            raise KeyboardInterrupt

    def _unraisable(self, unraisable: Any) -> None:
        """An exception in a callback of the garbage collector (jax has one) or in a finaliser reaches nobody."""
        if not isinstance(unraisable.exc_value, KeyboardInterrupt):
            self._hook(unraisable)
            return
        self.raised = False
        with contextlib.suppress(OSError):  # full: enough signals are on their way
            self._there.send(bytes([SWALLOWED]))

    def _watch(self) -> None:
        ends = None
        while True:
            left = None if ends is None else max(0.0, ends - time.monotonic())
            if not select.select([self._here], [], [], left)[0]:
                self.leave("stopped at once")
            received = self._here.recv(64)
            if not received:
                self._here.close()
                return
            for number in received:
                if number == SWALLOWED:
                    self._raise_again()
                elif self.resent and number == signal.SIGINT:
                    self.resent -= 1
                elif number in SIGNALS and self.received_at is None:
                    self.received_at = time.monotonic()
                    ends = self.received_at + FIRST
                elif number in SIGNALS and ends is not None and time.monotonic() > (self.received_at or 0.0) + TOGETHER:
                    ends = min(ends, time.monotonic() + SECOND)

    def _raise_again(self) -> None:
        """Once more in the main thread, a little later: at once it would be raised in the hook."""
        time.sleep(0.02)
        self.resent += 1
        _thread.interrupt_main(signal.SIGINT)

    def leave(self, how: str) -> NoReturn:
        """End the process here and now, its other threads with it, after one line about what is left."""

        def last_words() -> None:
            if os.isatty(1):
                os.write(1, SHOW_CURSOR)  # which a progress bar hides
            os.write(2, f"\ninterrupted, {how}; {describe_folder(self.out, self.before)}\n".encode())

        for step in (end_children, close_all, sys.stdout.flush, sys.stderr.flush, last_words):
            _within(LAST_WORDS, step)
        os._exit(INTERRUPTED)


@contextlib.contextmanager
def watch_signals(out: Path | None) -> Iterator[SignalWatch]:
    """A `SignalWatch` over the block; it stays after a signal: threads that compute keep a process from ending."""
    watch = SignalWatch(out)
    watch.begin()
    try:
        yield watch
    finally:
        if watch.received_at is None:
            watch.end()


def out_folder(arguments: Sequence[str]) -> Path | None:
    """The folder that a command line names with --out."""
    for argument, following in itertools.zip_longest(arguments, arguments[1:], fillvalue=""):
        name, equals, value = argument.partition("=")
        if name == "--out":
            return Path(value if equals else following)
    return None


Stamp = tuple[int, ...]  # of a file: what changes where it is written
GONE: Stamp = ()


def file_stamps(out: Path | None) -> dict[Path, Stamp]:
    """What a folder holds now, to tell later what was written since.

    Not by the clock: a file's time is that of the system's last tick, which may lie before a start read just now.
    """
    return {path: _stamp(path) for one in _visible(out) for path in _files_in(one)}


def describe_folder(out: Path | None, before: dict[Path, Stamp]) -> str:
    """What a folder holds that was written since `file_stamps` gave `before`, and what can be continued from.

    Unfinished files are hidden, and no part of it.
    """
    written, continued = [], []
    for one in _visible(out):
        if one.name in CONTINUED:
            continued.append(one.name)
        count = sum(_stamp(path) not in (GONE, before.get(path)) for path in _files_in(one))
        if one.is_dir() and count:
            written.append(f"{one.name} ({count} files)" if count > 1 else f"{one.name} (1 file)")
        elif count:
            written.append(one.name)
    sentence = f"{out} holds, of this run: {', '.join(written)}" if written else "it had written nothing"
    return sentence + (f"; the same command continues from {', '.join(continued)}" if continued else "")


def _visible(out: Path | None) -> list[Path]:
    with contextlib.suppress(OSError):
        return sorted(one for one in (out or Path(os.devnull)).iterdir() if not one.name.startswith("."))
    return []


def _files_in(place: Path) -> list[Path]:
    if not place.is_dir():
        return [place]
    return [Path(here) / name for here, _, names in os.walk(place) for name in names if not name.startswith(".")]


def _stamp(path: Path) -> Stamp:
    with contextlib.suppress(OSError):
        now = path.stat()
        return now.st_ino, now.st_size, now.st_mtime_ns
    return GONE


def _within(seconds: float, step: Callable[[], object]) -> None:
    """Run a step in a thread that nobody waits for longer: a reader that does not read must not keep the process."""

    def run() -> None:
        with contextlib.suppress(OSError, ValueError, RuntimeError):
            step()

    running = threading.Thread(target=run, daemon=True)
    running.start()
    running.join(seconds)
