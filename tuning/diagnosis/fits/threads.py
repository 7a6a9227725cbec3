"""Independent fits at once: two threads keep two cores busy, since a compiled roll-out uses one."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

THREADS = 2

A = TypeVar("A")
B = TypeVar("B")


def in_parallel(
    function: Callable[[A], B], items: Sequence[A], say: Callable[[int], None] = lambda done: None
) -> list[B]:
    """The function of each item, in their order; `say` is told how many are done, none at first.

    Give what takes longest first. Where one fails, or on Ctrl-C, those that have not begun are left out, and those that
    run are not waited for: that may take minutes.
    """
    found: list[B] = []
    say(0)
    pool = ThreadPoolExecutor(THREADS)
    try:
        for one in pool.map(function, items):
            found.append(one)
            say(len(found))
    finally:
        pool.shutdown(wait=False, cancel_futures=True)  # all are done where nothing was raised
    return found
