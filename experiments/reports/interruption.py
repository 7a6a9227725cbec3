"""Ctrl-C that lets a search end its step and keep the best so far, in place of losing everything in mid-computation."""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import ParamSpec

# s: a command ends within 15 s of the first signal and 5 s of the second; what is left is for a busy machine to end it
FIRST, SECOND = 11.0, 1.5
TOGETHER = 0.5  # s: `timeout` signals a process and then its group, and so each process twice
SIGNALS = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGBREAK") if hasattr(signal, name))

Arguments = ParamSpec("Arguments")
SignalHandler = Callable[[int, FrameType | None], object] | int | signal.Handlers | None


@contextlib.contextmanager
def stop_at_next_step(
    progress: Callable[Arguments, None], say: Callable[[str], None]
) -> Iterator[Callable[Arguments, None]]:
    """Yields `progress` for a search: after a Ctrl-C it ends the search between two steps, where that keeps its best.

    It raises `KeyboardInterrupt` once: what comes after the search goes on, and reports progress, too.

    SIGTERM is taken like it. What comes after the search (covariance, verification) is computed as far as the time
    allows that `ending.SignalWatch` leaves. A second one stops at once. Signals reach only the main thread; in another
    this changes nothing.
    """
    first: float | None = None
    ended = False
    before: dict[signal.Signals, SignalHandler] = {}

    def ask(number: int, frame: FrameType | None) -> None:
        nonlocal first
        if first is None:
            first = time.monotonic()
            say(
                "Interrupted: the search ends with this step, and the best so far is written if that takes no longer "
                f"than {FIRST:.0f} s (again to stop at once)."
            )
        elif time.monotonic() - first > TOGETHER:
            handler = before[signal.Signals(number)]
            if not callable(handler):
                raise KeyboardInterrupt
            handler(number, frame)  # which raises once: a further one must not break the writing of results

    def step(*arguments: Arguments.args, **named: Arguments.kwargs) -> None:
        nonlocal ended
        progress(*arguments, **named)
        if first is not None and not ended:
            ended = True
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield progress
        return
    before |= {one: signal.signal(one, ask) for one in SIGNALS}
    try:
        yield step
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
