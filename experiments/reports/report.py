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
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.text import Text

from diffdrive.results import as_json
from diffdrive.support.atomic_write import atomic_write
from diffdrive.support.messages import printable
from experiments.reports import progress, readable
from experiments.reports.formats import figure_formats
from experiments.reports.output_folder import OutputFolder

if TYPE_CHECKING:
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

RESULT = "result.json"
NO_ROOM = f"OSError: [Errno {errno.ENOSPC}] {os.strerror(errno.ENOSPC)}"


def plain(value: object) -> Any:
    """The value as JSON can hold it; infinite and undefined numbers become their names."""
    return as_json(value, str)


def _json(data: dict[str, object]) -> str:
    return json.dumps(plain(data), indent=2, allow_nan=False) + "\n"


PIPED = 120  # columns of a pipe or a log file, which has no width of its own


def _console() -> Console:
    # what is printed quotes files: [brackets] and :names: in it are no markup and no emoji
    console = Console(markup=False, emoji=False, highlight=False, soft_wrap=True)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = PIPED
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
        # sentences for a pipe stay in one line, for whoever searches in it
        self.width = self.console.width if self.console.is_terminal or "COLUMNS" in os.environ else None
        self._later: list[tuple[Sequence[str], str]] | None = None  # what is printed after the result
        self._blank = False  # whether the last line that was printed is empty
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
        self._print(self._prose(title), style="bold")

    def __enter__(self) -> "Report":
        """Raises `ParameterError` where another run writes to the folder."""
        if self._folder is not None:
            self._folder.open(len(self._stopped(NO_ROOM)))
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: object) -> None:
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
        """Keep room on the disk for what result.json holds by now: a disk that fills up is reported there, too."""
        if self._folder is not None:
            self._folder.hold(len(self._stopped(NO_ROOM)))

    def _stopped(self, by: str, without: Sequence[str] = ()) -> str:
        """result.json of a command that was stopped, in ASCII."""
        kept = {key: value for key, value in self.data.items() if key not in without}
        return _json({"stopped_by": by} | kept)

    def say(self, text: str) -> None:
        """Print a sentence, or several lines, and keep it."""
        self.data.setdefault("notes", []).append(text)
        self._hold()
        self._print(self._prose(text))

    def print(self, text: str, style: str = "") -> None:
        """Print it, and keep nothing: it says what is kept elsewhere."""
        self._print(self._prose(text), style)

    def keep(self, name: str, **numbers: object) -> None:
        """Keep named numbers, the unit in the name (rms_um), without a word."""
        self.data.setdefault(name, {}).update(plain(numbers))
        self._hold()

    def show_numbers(self, name: str) -> None:
        """Print the named numbers that are kept by this name."""
        self._print(readable.numbers(name, self.data[name], self.console.width))

    def values(self, name: str, **numbers: object) -> None:
        """Print named numbers (the unit belongs into the name: rms_um) and keep them."""
        self.keep(name, **numbers)
        self._print(readable.numbers(name, numbers, self.console.width))

    def record(self, name: str, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
        """Keep a table, and write it as CSV, without a word."""
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

    def show(
        self,
        caption: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[object]],
        digits: int = readable.DIGITS,
        notes: Sequence[str] = (),
    ) -> None:
        """Print a table, as wide as the terminal, with so many significant digits; below it what its rows need said.

        A column's unit is in its name: `RMS um`, `share, %`.
        """
        self._print(["", *self._prose(caption)], style="bold")
        for k, block in enumerate(readable.table(columns, rows, self.console.width, digits)):
            self._print([""] if k else [])
            rule = next(k for k, line in enumerate(block) if line.startswith("─"))
            self._print(block[:rule], style="dim")
            self._print(block[rule:])
        for note in notes:
            self._print(self._prose(note))
        self._print([""])

    def table(
        self,
        name: str,
        columns: Sequence[str],
        rows: Sequence[Sequence[object]],
        caption: str = "",
        digits: int = readable.DIGITS,
        notes: Sequence[str] = (),
    ) -> None:
        """`record` a table and `show` it."""
        self.show(caption or readable.titled(name.replace("_", " ")), columns, rows, digits, notes)
        self.record(name, columns, rows)

    @contextlib.contextmanager
    def result_first(self) -> Iterator[Callable[[str], None]]:
        """Yields a function for the sentence with the result; whatever else is printed within comes after it."""
        sentences: list[str] = []
        later: list[tuple[Sequence[str], str]] = []
        self._later = later
        try:
            yield sentences.append
        finally:
            self._later = None
            for sentence in sentences:
                self.data.setdefault("notes", []).append(sentence)
                self._print(["", *self._prose(sentence)], style="bold")
            for lines, style in later:
                self._print(lines, style)

    def _prose(self, text: str) -> list[str]:
        """Lines that break between words at the terminal's width; whole where there is no terminal."""
        lines = [readable.readable(printable(line)) for line in text.split("\n")]
        return [part for line in lines for part in readable.wrapped(line, self.width or len(line) + 1)]

    def _print(self, lines: Sequence[str], style: str = "") -> None:
        if self._later is not None:
            self._later.append((lines, style))
            return
        for line in lines:
            if not line and self._blank:
                continue
            self._blank = not line
            text = readable.in_ascii(line) if self.console.options.ascii_only else line
            self.console.print(Text(text, style=style))

    def figure(self, name: str, figure: "Figure") -> None:
        """Save a figure as PNG, and in the other formats of `figure_formats`."""
        if self.out is not None:
            for ending in figure_formats.get():
                with atomic_write(self.out / f"{name}.{ending}") as file:
                    figure.savefig(file, format=ending, dpi=130)
                self.data.setdefault("figures", []).append(f"{name}.{ending}")
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

    def progress(self, what: str, total: int) -> AbstractContextManager[Callable[[int, int, float], None]]:
        """A bar for a search; yields a function of (step, most, cost) that moves it."""
        return progress.steps(self.console, what, total)

    def stages(self) -> AbstractContextManager[Callable[[str, int, int], None]]:
        """Progress through named stages; yields a function of (stage, done, of how many)."""
        return progress.stages(self.console)

    def counted(self, what: str, total: int) -> AbstractContextManager[Callable[[int], None]]:
        """A bar with rate and time left; yields a function of how many are done."""
        return progress.counted(self.console, what, total)

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
) -> tuple["Figure", Any]:
    """A figure and its axes ([rows, columns] squeezed), drawn without a display and without global state."""
    import matplotlib as mpl  # a third of a second to import, and no figure is drawn without a folder to write it to
    from matplotlib.figure import Figure

    with mpl.rc_context({"axes.grid": True, "grid.alpha": 0.3}):
        figure = Figure(figsize=(width, height * rows), layout="constrained")
        axes = figure.subplots(rows, columns, sharex="col" if share_x else False)
    return figure, axes


def plain_logarithmic(axis: "Axis") -> None:
    """Label one axis of a logarithmic plot 0.1, 1, 20 in place of powers of ten, fewer of them the more it spans."""
    from matplotlib.ticker import FuncFormatter

    def between(value: float, _: object) -> str:
        low, high = axis.get_view_interval()
        decades, digit = math.log10(high / low), round(value / 10.0 ** math.floor(math.log10(value) + 1e-9))
        shown = range(2, 10) if decades < 1.0 else (2, 5) if decades < 2.0 else ()
        return f"{value:g}" if digit in shown else ""

    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(FuncFormatter(between))
