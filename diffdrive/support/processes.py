"""Processes that compute side by side, and none of which outlives the one that asked for it."""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor


@contextlib.contextmanager
def processes(count: int, initializer: Callable[[], None] | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of so many processes, spawned, since a forked JAX hangs.

    On an exception, Ctrl-C with it, they are ended: nobody waits for what they compute. They end by themselves where
    the process that began them was killed.
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
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # a terminal sends Ctrl-C to all; the process that asked decides
    parent = multiprocessing.parent_process()
    assert parent is not None
    exit_after(parent.join)
    if initializer is not None:
        initializer()


def exit_after(wait: Callable[[], object]) -> None:
    """End this process and those that it has begun, whatever they compute, once `wait` has returned."""

    def watch() -> None:
        wait()
        end_children()
        os._exit(1)

    threading.Thread(target=watch, name="parent", daemon=True).start()


def end_children() -> None:
    """End the processes that this one has begun: they see too late that it is gone while they still import."""
    for one in multiprocessing.active_children():
        one.kill()
