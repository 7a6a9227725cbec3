"""What a command prints, and the folder it writes: figures, tables, and one result.json with every number printed."""

import contextlib
import csv
import errno
import importlib.metadata
import json
import math
import os
import platform
import re
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from diffdrive.support.atomic_write import atomic_write
from diffdrive.support.messages import printable
from experiments.reports.output_folder import OutputFolder

RESULT = "result.json"
NO_ROOM = f"OSError: [Errno {errno.ENOSPC}] {os.strerror(errno.ENOSPC)}"


def plain(value: Any) -> Any:
    """The value as JSON can hold it, which has no infinite or undefined numbers: they become their names."""
    if isinstance(value, dict):
        return {str(key): plain(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [plain(one) for one in value]
    if isinstance(value, np.ndarray) or hasattr(value, "__jax_array__") or type(value).__module__.startswith("jax"):
        return plain(np.asarray(value).tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return str(value)
    return value


def _json(data: dict[str, Any]) -> str:
    return json.dumps(plain(data), indent=2, allow_nan=False) + "\n"


def _shown(value: Any, digits: int = 4) -> str:
    if value is None:
        return "-"
    return f"{value:.{digits}g}" if isinstance(value, float | np.floating) else str(value)


SELDOM = 30.0  # s, between two lines of progress where there is no terminal


def _console() -> Console:
    # what is printed quotes files: [brackets] and :names: in it are no markup and no emoji
    console = Console(markup=False, emoji=False, highlight=False, soft_wrap=True)
    if not console.is_terminal:
        console.width = 120  # a pipe or a log file has no width of its own
    return console


def version_of(package: str) -> str:
    """The edition of a package as it is installed."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:  # run from a checkout
        return "not installed"


class Report:
    """Collects what a command finds, prints it as it comes, and writes it to the folder `out`, if there is one.

    A command that is stopped before its first number, table or figure leaves the folder as it was: what an earlier one
    wrote there stays whole.
    """

    def __init__(self, title: str, out: Path | None, console: Console | None = None) -> None:
        self.out = out
        self.console = console or _console()
        self.data: dict[str, Any] = {
            "title": title,
            "made_by": {
                "arguments": sys.argv[1:],
                "diffdrive": version_of("diffdrive"),
                "jax": version_of("jax"),
                "python": platform.python_version(),
            },
        }
        self._started = time.perf_counter()
        self._no_result = {*self.data, "timings_s", "notes"}
        self._folder = None if out is None else OutputFolder(out, RESULT)
        self.console.print(printable(title), style="bold")

    def __enter__(self) -> "Report":
        """Raises `ParameterError` where another run writes to the folder."""
        if self._folder is not None:
            self._folder.open(len(self._stopped(NO_ROOM)))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: Any) -> None:
        """Write what there is, also when the work was interrupted or failed; nothing where there is nothing yet."""
        try:
            if kind is None:
                self.close()
            elif self.data.keys() - self._no_result:
                self.data["stopped_by"] = f"{kind.__name__}: {error}".rstrip(": ")
                self.close()
        finally:
            if self._folder is not None:
                self._folder.close()

    def _hold(self) -> None:
        """Keep room on the disk for what result.json holds by now: a disk that fills up is told there, too."""
        if self._folder is not None:
            self._folder.hold(len(self._stopped(NO_ROOM)))

    def _stopped(self, by: str, without: Sequence[str] = ()) -> str:
        """result.json of a command that was stopped, in ASCII."""
        kept = {key: value for key, value in self.data.items() if key not in without}
        return _json({"stopped_by": by} | kept)

    def say(self, text: str) -> None:
        """Print a sentence and keep it."""
        self.data.setdefault("notes", []).append(text)
        self._hold()
        self.console.print(printable(text))

    def values(self, name: str, **numbers: Any) -> None:
        """Print named numbers (the unit belongs into the name: rms_um) and keep them."""
        self.data.setdefault(name, {}).update(plain(numbers))
        self._hold()
        listed = ", ".join(f"{key} {_shown(value)}" for key, value in numbers.items())
        self.console.print(printable(f"{name}: {listed}"))

    def table(
        self, name: str, columns: Sequence[str], rows: Sequence[Sequence[Any]], caption: str = "", digits: int = 4
    ) -> None:
        """Print a table with so many significant digits, keep its rows as records, and write it as CSV."""
        drawn = Table(title=printable(caption or name), title_justify="left", header_style="")
        for k, column in enumerate(columns):
            # a name that is cut off says nothing: it goes on in the next line
            drawn.add_column(printable(column), justify="left" if k == 0 else "right", overflow="fold")
        for row in rows:
            drawn.add_row(*(printable(_shown(value, digits)) for value in row))
        self.console.print(drawn)
        self.data.setdefault("tables", {})[name] = {
            "columns": list(columns),
            "rows": plain([list(row) for row in rows]),
        }
        if self.out is not None:
            self._hold()
            with atomic_write(self.out / f"{name}.csv", "w") as file:
                writer = csv.writer(file)
                writer.writerow(columns)
                writer.writerows(rows)

    def figure(self, name: str, figure: Any) -> None:
        """Save a figure as PNG."""
        if self.out is not None:
            with atomic_write(self.out / f"{name}.png") as file:
                figure.savefig(file, format="png", dpi=130)
            self.data.setdefault("figures", []).append(f"{name}.png")
            self._hold()

    @contextlib.contextmanager
    def working(self, what: str) -> Iterator[None]:
        """Show that something is under way, and how long it took."""
        began = time.perf_counter()
        with self.console.status(Text(printable(f"{what} ..."))):
            yield
        elapsed = time.perf_counter() - began
        self.data.setdefault("timings_s", {})[what] = round(elapsed, 1)
        if elapsed > 2:
            self.console.print(printable(f"{what}: {elapsed:.1f} s"), style="dim")

    @contextlib.contextmanager
    def progress(self, what: str, total: int) -> Iterator[Callable[[int, int, float], None]]:
        """A progress bar; yields a function of (step, most, cost) that moves it."""
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[note]}", markup=False),
        )
        with Progress(*columns, TimeElapsedColumn(), console=self.console) as bar:
            task = bar.add_task(printable(what), total=total, note="compiling")

            def advance(step: int, most: int, cost: float) -> None:
                bar.update(task, completed=step, total=most, note=f"cost {cost:.4g}")

            yield advance

    @contextlib.contextmanager
    def stages(self) -> Iterator[Callable[[str, int, int], None]]:
        """Progress through named stages; yields a function of (stage, done, of how many).

        Where no terminal draws bars, a line says when a stage begins and when it has ended: a job's log shows life.
        """
        if not self.console.is_terminal:
            yield self._lines()
            return
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, TimeElapsedColumn(), console=self.console) as bar:
            tasks: dict[str, Any] = {}

            def advance(stage: str, done: int, most: int) -> None:
                if stage not in tasks:
                    tasks[stage] = bar.add_task(printable(stage), total=most)
                bar.update(tasks[stage], completed=done, total=most)

            yield advance

    def _lines(self) -> Callable[[str, int, int], None]:
        """Progress as lines, one as a stage begins, one as it ends, and between them one now and then."""
        began = time.perf_counter()
        before, at, told = "", 0.0, 0  # the stage that was told last, when, and how far it had come

        def advance(stage: str, done: int, most: int) -> None:
            nonlocal before, at, told
            now = time.perf_counter() - began
            begins = stage != before or done < told
            if begins or now - at >= SELDOM or (done == most and told != most):
                before, at, told = stage, now, done
                self.console.print(printable(f"{stage}: {done} of {most}, {now:.0f} s"))

        return advance

    @contextlib.contextmanager
    def counted(self, what: str, total: int) -> Iterator[Callable[[int], None]]:
        """A progress bar with rate and time left; yields a function of how many are done."""
        rate = TextColumn("{task.fields[rate]}", markup=False)
        columns = (TextColumn("{task.description}", markup=False), BarColumn(), MofNCompleteColumn(), rate)
        with Progress(*columns, TimeElapsedColumn(), TimeRemainingColumn(), console=self.console) as bar:
            task = bar.add_task(printable(what), total=total, rate="compiling")
            began: list[tuple[float, int]] = []

            def advance(done: int) -> None:
                now = time.perf_counter()
                began.append((now, done)) if not began else None
                gone, since = now - began[0][0], done - began[0][1]
                bar.update(task, completed=done, rate=f"{since / gone:.4g}/s" if gone > 0.0 and since else "compiling")

            yield advance

    def close(self) -> None:
        """Write result.json; on a full disk what there is room for, and raise `OSError`."""
        self.data["seconds"] = round(time.perf_counter() - self._started, 2)
        if self._folder is None:
            return
        least = self.data.keys() - {"title", "made_by", "seconds", "stopped_by"}
        shorter = (self._stopped(NO_ROOM, ("tables",)), self._stopped(NO_ROOM, tuple(least)))
        if self._folder.write_result(_json(self.data), *shorter) and "stopped_by" not in self.data:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        stopped = "stopped; what was found by then is in" if "stopped_by" in self.data else "written to"
        self.console.print(printable(f"{stopped} {self.out}"))


def named_file(text: str) -> str:
    """The text as part of a file's name."""
    return re.sub(r"[^\w.+-]+", "_", text).strip("_.")


def new_figure(
    rows: int = 1, columns: int = 1, *, width: float = 8.0, height: float = 3.0, share_x: bool = True
) -> Any:
    """A figure and its axes ([rows, columns] squeezed), drawn without a display and without global state."""
    import matplotlib as mpl  # a third of a second to import, and no figure is drawn without a folder to write it to
    from matplotlib.figure import Figure

    with mpl.rc_context({"axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(width, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, sharex="col" if share_x else False)
    return figure, axes


def plain_logarithmic(axis: Any) -> None:
    """Label one axis of a logarithmic plot 0.1, 1, 20 in place of powers of ten, fewer of them the more it spans."""
    from matplotlib.ticker import FuncFormatter

    def between(value: float, _: Any) -> str:
        low, high = axis.get_view_interval()
        decades, digit = math.log10(high / low), round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
        shown = range(2, 10) if decades < 1.0 else (2, 5) if decades < 2.0 else ()
        return f"{value:g}" if digit in shown else ""

    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(between))
