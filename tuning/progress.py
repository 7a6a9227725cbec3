"""Progress of a long call: to a callback of the caller's, or drawn where somebody watches a terminal or a notebook."""

import contextlib
import importlib.util
import sys
from collections.abc import Callable, Iterator

Progress = Callable[[str, int, int], None]  # of what, how many steps are done, of how many


def silent(stage: str, done: int, most: int) -> None:
    """Show nothing."""


@contextlib.contextmanager
def reporting(progress: Progress | None) -> Iterator[Progress]:
    """The callback to report to: `progress` where there is one, else bars where there is a terminal or a notebook."""
    if progress is not None:
        yield progress
        return
    if not _is_watched():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TaskID, TextColumn, TimeElapsedColumn
    from rich.progress import Progress as Bars

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Bars(*columns, console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def advance(stage: str, done: int, most: int) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=most)
            bars.update(tasks[stage], completed=done, total=most)

        yield advance


@contextlib.contextmanager
def searching(advance: Progress, stage: str) -> Iterator[Callable[[int, int, float], None]]:
    """A search's steps as a stage, complete when the search ends: it may converge before its last step."""
    last = 0

    def step(done: int, most: int, _cost: float) -> None:
        nonlocal last
        last = done
        advance(stage, done, most)

    yield step
    if last:
        advance(stage, last, last)


def _is_watched() -> bool:
    # without ipywidgets a notebook would show, in place of a bar, a warning at each of its steps
    notebook = "ipykernel" in sys.modules and importlib.util.find_spec("ipywidgets") is not None
    return notebook or bool(getattr(sys.stderr, "isatty", lambda: False)())
