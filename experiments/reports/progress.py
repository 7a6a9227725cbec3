"""Progress of what takes long: bars on a terminal, lines in a file; each names its work and ends at its total."""

import contextlib
import time
from collections.abc import Callable, Iterator

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from diffdrive.support.messages import printable

SELDOM = 30.0  # s, between two lines of progress where there is no terminal
DESCRIPTION = TextColumn("{task.description}", markup=False)
NOTE = TextColumn("{task.fields[note]}", markup=False)


@contextlib.contextmanager
def steps(console: Console, what: str, total: int) -> Iterator[Callable[[int, int, float], None]]:
    """A bar for a search that may end before its last step; yields a function of (step, most, cost) that moves it."""
    with Progress(DESCRIPTION, BarColumn(), MofNCompleteColumn(), NOTE, TimeElapsedColumn(), console=console) as bar:
        task = bar.add_task(printable(what), total=total, note="compiling")
        done = 0

        def advance(step: int, most: int, cost: float) -> None:
            nonlocal done
            done = step
            bar.update(task, completed=step, total=most, note=f"cost {cost:.4g}")

        yield advance
        if done:  # a search that has converged has come to its end
            bar.update(task, completed=done, total=done)


@contextlib.contextmanager
def stages(console: Console) -> Iterator[Callable[[str, int, int], None]]:
    """Progress through named stages; yields a function of (stage, done, of how many).

    Where no terminal draws bars, a line says when a stage begins and when it has ended: a job's log shows life.
    """
    if not console.is_terminal:
        yield _lines(console)
        return
    with Progress(DESCRIPTION, BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), console=console) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, done: int, most: int) -> None:
            if stage not in tasks:
                tasks[stage] = bar.add_task(printable(stage), total=most)
            bar.update(tasks[stage], completed=done, total=most)

        yield advance


def _lines(console: Console) -> Callable[[str, int, int], None]:
    """Progress as lines, one as a stage begins, one as it ends, and between them one now and then."""
    began = time.perf_counter()
    current, printed_at, printed = "", 0.0, 0  # the stage of the last line, when that was, and how far it had come

    def advance(stage: str, done: int, most: int) -> None:
        nonlocal current, printed_at, printed
        now = time.perf_counter() - began
        begins = stage != current or done < printed
        if begins or now - printed_at >= SELDOM or (done == most and printed != most):
            current, printed_at, printed = stage, now, done
            console.print(printable(f"{stage}: {done} of {most}, {now:.0f} s"))

    return advance


@contextlib.contextmanager
def counted(console: Console, what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A bar with rate and time left; yields a function of how many are done."""
    rate = TextColumn("{task.fields[rate]}", markup=False)
    columns = (DESCRIPTION, BarColumn(), MofNCompleteColumn(), rate, TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(printable(what), total=total, rate="compiling")
        began: list[tuple[float, int]] = []

        def advance(done: int) -> None:
            now = time.perf_counter()
            began.append((now, done)) if not began else None
            gone, since = now - began[0][0], done - began[0][1]
            bar.update(task, completed=done, rate=f"{since / gone:.4g}/s" if gone > 0.0 and since else "compiling")

        yield advance
