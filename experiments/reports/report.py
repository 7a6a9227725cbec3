"""What a command prints, and the folder it writes: figures, tables, a page, and result.json with every number."""

import contextlib
import csv
import datetime
import errno
import importlib.metadata
import json
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
from diffdrive.support.atomic_write import NO_SPACE, atomic_write, write_text
from diffdrive.support.messages import printable
from experiments.reports import progress, readable, theme
from experiments.reports.formats import figure_formats
from experiments.reports.output_folder import OutputFolder
from experiments.reports.page.chart import Chart
from experiments.reports.page.contents import Contents, Picture, ShownTable, described

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RESULT = "result.json"
PAGE = "report.html"
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
    wrote there stays as it is.
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
                "date": datetime.datetime.now().astimezone().isoformat(sep=" ", timespec="minutes"),
            },
        }
        self.page = Contents()
        self._started, self._began = time.perf_counter(), time.time()
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
        *,
        of: str = "",
        infinite: str = readable.INFINITE,
    ) -> None:
        """Print a table, as wide as the terminal, with so many significant digits; below it what its rows need said.

        A column's unit is in its name: `RMS um`, `share, %`; `infinite` is what infinity means in it. `of` is the table
        that is recorded with the same content: the page has it once.
        """
        self.page.tables.append(ShownTable(caption, columns, rows, digits, notes, of, infinite))
        self._print(["", *self._prose(caption)], style="bold")
        for k, block in enumerate(readable.table(columns, rows, self.console.width, digits, infinite)):
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
        infinite: str = readable.INFINITE,
    ) -> None:
        """`record` a table and `show` it."""
        caption = caption or readable.titled(name.replace("_", " "))
        self.show(caption, columns, rows, digits, notes, of=name, infinite=infinite)
        self.record(name, columns, rows)

    def conclude(self, *sentences: str, verdict: str = "", good: bool | None = None) -> None:
        """What the page begins with: the result in sentences, in a word, and whether it is good; prints nothing."""
        self.page.conclusions += sentences
        self.page.verdict = verdict or self.page.verdict
        self.page.good = self.page.good if good is None else good

    def result(self, *sentences: str, good: bool | None = None) -> None:
        """Print the result, and begin the page with it: of a command whose result comes last."""
        for sentence in sentences:
            self.say(sentence)
        self.conclude(*sentences, good=good)

    @contextlib.contextmanager
    def result_first(self) -> Iterator[Callable[[str], None]]:
        """Yields a function for the sentence with the result; whatever else is printed within comes after it."""
        sentences: list[str] = []
        later: list[tuple[Sequence[str], str]] = []
        self._later = later
        notes: list[str] = self.data.setdefault("notes", [])
        first = len(notes)
        try:
            yield sentences.append
        finally:
            self._later = None
            self.conclude(*sentences)
            notes[first:first] = sentences
            for sentence in sentences:
                self._print(["", *self._prose(sentence)], style="bold")
            for lines, style in later:
                self._print(lines, style)

    def _prose(self, text: str) -> list[str]:
        """Lines that break between words at the terminal's width; unbroken where there is no terminal."""
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

    def figure(self, name: str, figure: "Figure", caption: str = "") -> None:
        """Save a figure as PNG, and in the other formats of `figure_formats`; the page shows it with its caption."""
        if self.out is not None:
            for ending in figure_formats.get():
                with atomic_write(self.out / f"{name}.{ending}") as file:
                    theme.save(figure, file, ending)
                self.data.setdefault("figures", []).append(f"{name}.{ending}")
            caption = caption or readable.titled(name.replace("_", " "))
            # once it is there: the page of a command that ends on a full disk shows what was written
            self.page.pictures.append(Picture(name, f"{name}.png", caption, described(caption, figure)))
            self._hold()

    def chart(self, name: str, chart: Chart) -> None:
        """A chart to zoom into, for the page; on paper the figure of the same name stands in its place."""
        self.page.charts[name] = chart

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

    def write_page(self) -> None:
        """Write report.html of what is there by now; raises `OSError` where there is no room."""
        if self.out is not None:
            from experiments.reports.page.page import Page, render  # Jinja2 takes a tenth of a second to import

            write_text(self.out / PAGE, render(Page(self.data, self.page, self.out, PAGE, self._began)))

    def close(self) -> None:
        """Write report.html and result.json; on a full disk what there is room for, and raise `OSError`."""
        self.data["seconds"] = round(time.perf_counter() - self._started, 2)
        if self._folder is None:
            return
        was_stopped, is_full = "stopped_by" in self.data, False
        try:
            self.write_page()
        except OSError as problem:
            is_full = problem.errno in NO_SPACE
            if not is_full:
                raise
            self.data.setdefault("stopped_by", NO_ROOM)
        finally:  # whatever fails, the numbers are kept
            least = self.data.keys() - {"title", "made_by", "seconds", "stopped_by"}
            shorter = (self._stopped(NO_ROOM, ("tables",)), self._stopped(NO_ROOM, tuple(least)))
            is_full = bool(self._folder.write_result(_json(self.data), *shorter)) or is_full
        if is_full and not was_stopped:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        stopped = "stopped; what was found by then is in" if was_stopped else "written to"
        self.console.print(printable(f"{stopped} {self.out}"))


def named_file(text: str) -> str:
    """The text as part of a file's name."""
    return re.sub(r"[^\w.+-]+", "_", text).strip("_.")
