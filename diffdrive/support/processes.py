"""Parallel processes, none of which outlives the one that started it."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor


@contextlib.contextmanager
def processes(count: int, initializer: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of `count` processes, spawned, since a forked JAX hangs.

    An exception, also Ctrl-C, terminates them without waiting. They exit by themselves if their parent was killed.
    """
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(count, context, initializer=_begin, initargs=(initializer,)) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise


def _begin(initializer: Callable[[], None] | None) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the parent decides
    parent = multiprocessing.parent_process()
    assert parent is not None
    exit_after(parent.join)
    if initializer is not None:
        initializer()


def exit_after(wait: Callable[[], object]) -> None:
    """End this process and its children, whatever they compute, once `wait` has returned."""

    def watch() -> None:
        wait()
        end_children()
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def end_children() -> None:
    """Kill the child processes: while they import they would notice too late that their parent is gone."""
    for child in multiprocessing.active_children():
        child.kill()
