"""Ctrl-C that lets a search end its step and keep the best so far, in place of losing everything in mid-computation."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

from tuning.least_squares import Progress


@contextlib.contextmanager
def at_next_step(progress: Progress, say: Callable[[str], None]) -> Iterator[Progress]:
    """Yields `progress` for a search: after a Ctrl-C it ends the search between two steps, where that keeps its best.

    SIGTERM is taken like it. What comes after the search (covariance, intervals) is still computed. A second one stops
    at once. Signals reach only the main thread; in another this changes nothing.
    """
    asked = False

    def ask(*_: Any) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True
        say("Interrupted: the search ends with the step it is in, and the best so far is kept (again to stop at once).")

    def step(count: int, most: int, cost: float) -> None:
        progress(count, most, cost)
        if asked:
            raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield progress
        return
    before = {one: signal.signal(one, ask) for one in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield step
    finally:
        for one, handler in before.items():
            signal.signal(one, handler)
