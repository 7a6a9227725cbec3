"""What the sections of every page take of a report."""

import base64
import contextlib
import shlex
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from experiments.reports import readable
from experiments.reports.page.plotly import figure, legend, share
from experiments.reports.page.table import page_table
from experiments.reports.page.text import data_block

if TYPE_CHECKING:
    from experiments.reports.page.page import Page

POINTS = 150_000  # of all charts together: at most 16 bytes each, 3.2 MB as they stand on a page
PICTURES = 2_500_000  # bytes of all pictures together, 3.3 MB on a page; with charts and plotly.js less than 8 MB
NOT_NUMBERS = ("title", "made_by", "tables", "figures", "notes", "timings_s", "seconds", "stopped_by", "says")
FILES = ("file", "files")  # which have a section of their own
KINDS = {
    ".json": "for programs", ".csv": "table", ".png": "picture", ".svg": "picture", ".toml": "drive file or settings",
    ".parquet": "table", ".nc": "signals", ".md": "text", ".st": "code", ".c": "code", ".h": "code", ".hal": "code",
    ".comp": "code", ".py": "code", ".fmu": "model for co-simulation", ".pdf": "picture",
}  # fmt: skip
SECOND = 1.0  # by which the clock of a network drive may be behind

Taken = Mapping[str, Any] | None


def result(page: "Page") -> Taken:
    """The conclusions, or else the first remark: what a reader wants to know first."""
    contents, stopped = page.contents, page.data.get("stopped_by")
    lines = contents.conclusions or page.data.get("notes", [])[:1]
    if stopped is not None:
        return {"kind": "bad", "verdict": "stopped", "lines": [_stopped(str(stopped)), *lines]}
    kind = {True: "good", False: "bad", None: "plain"}[contents.good]
    return {"kind": kind, "verdict": contents.verdict, "lines": lines or ["Done."]}


def _stopped(by: str) -> str:
    """Who has pressed Ctrl-C, or Stop in the app, reads no name of an exception."""
    if by == "KeyboardInterrupt":
        return "The command was interrupted. What it had found by then stands here."
    return f"The command was stopped by {by}."


def numbers(page: "Page") -> Taken:
    """Named numbers, a table for each group."""
    groups = []
    for name, values in page.data.items():
        if name in NOT_NUMBERS or not isinstance(values, dict) or not values:
            continue
        rows = []
        for key, value in values.items():
            words, unit = readable.heading(key)
            within = value if isinstance(value, dict) else {"": value}
            rows += [
                [": ".join(one for one in (words or key, inner) if one), it, unit]
                for inner, it in within.items()
                if it not in ([], ()) and key not in FILES and not _is_series(it)
            ]
        if all(isinstance(it, str) or it is None for _, it, _ in rows):  # which sentences say better
            continue
        with_units = 3 if any(unit for *_, unit in rows) else 2
        columns = ("quantity", "value", "unit")[:with_units]
        groups.append(page_table(_title(name), columns, [row[:with_units] for row in rows]))
    return {"tables": groups} if groups else None


def _is_series(value: object) -> bool:
    """Lists of lists are for programs, which find them in result.json: as a row they would be wider than any screen."""
    return isinstance(value, list | tuple) and any(isinstance(one, list | tuple | dict) for one in value)


def figures(page: "Page") -> Taken:
    """Charts to zoom into, and pictures; a picture of a chart's name is the chart on paper."""
    return shown_figures(page, {*page.contents.charts, *(one.name for one in page.contents.pictures)} - page.shown)


def shown_figures(page: "Page", names: set[str]) -> Taken:
    """The figures of these names; what a section shows is not shown again."""
    found = {one.name: one for one in page.contents.pictures if one.name in names}
    items = []
    most = share(list(page.contents.charts.values()), POINTS)
    for name in dict.fromkeys([*found, *(name for name in page.contents.charts if name in names)]):
        chart, picture = page.contents.charts.get(name), found.get(name)
        item: dict[str, Any] = {"name": name, "caption": "", "chart": None, "picture": None}
        if picture is not None:
            item |= {"caption": picture.caption, "picture": _embedded(page, picture.file), "file": _url(picture.file)}
            item["description"] = picture.description
        if chart is not None:
            item |= {"caption": chart.caption, "chart": data_block(figure(chart, most)), "legend": legend(chart)}
        items.append(item)
        page.shown.add(name)
    return {"items": items} if items else None


def _embedded(page: "Page", file: str) -> str | None:
    """The picture inside the page, or None where the page has no room for it, and links it."""
    data = (page.folder / file).read_bytes()
    if page.pictured + len(data) > PICTURES:
        return None
    page.pictured += len(data)
    return f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"


def tables(page: "Page") -> Taken:
    """Tables as they were printed, and those that were only written."""
    shown = [
        page_table(
            one.caption, one.columns, one.rows,
            digits=one.digits, infinite=one.infinite, notes=one.notes, file=_url(f"{one.of}.csv") if one.of else "",
        )
        for one in page.contents.tables
    ]  # fmt: skip
    printed = {one.of for one in page.contents.tables}
    for name, one in page.data.get("tables", {}).items():
        if name not in printed and name not in page.shown:
            shown.append(page_table(_title(name), one["columns"], one["rows"], file=_url(f"{name}.csv")))
    return {"tables": shown} if shown else None


def remarks(page: "Page") -> Taken:
    """The sentences that were printed, less those of the result."""
    said = [note for note in page.data.get("notes", []) if note not in page.contents.conclusions]
    lines = [line.strip() for note in said for line in note.strip().split("\n")]
    return {"lines": [line.removeprefix("- ") for line in lines if line]} if said else None


def logs(page: "Page") -> Taken:
    """What was read."""
    if not page.contents.logs:
        return None
    shown = {readable.heading(name) for one in page.contents.tables if one.of == "logs" for name in one.columns}
    named = dict.fromkeys(key for one in page.contents.logs for key in one)
    columns = [name for name in named if name == "log" or readable.heading(name) not in shown]  # not twice on a page
    rows = [[one.get(name) for name in columns] for one in page.contents.logs]
    return {"table": page_table("What was read", columns, rows)}


def files(page: "Page") -> Taken:
    """Links to what this run wrote beside the page."""
    named = {"result.json", *page.data.get("figures", []), *(f"{name}.csv" for name in page.data.get("tables", {}))}
    with contextlib.suppress(OSError):  # a network drive may fail to list what it has written
        for path in page.folder.iterdir():
            if path.is_file() and not path.name.startswith(".") and path.stat().st_mtime >= page.began - SECOND:
                named.add(path.name)
    rows = [
        {"url": _url(name), "name": name, "kind": KINDS.get(f".{name.rpartition('.')[2]}", "file")}
        for name in sorted(named - {page.name}, key=lambda name: (name != "result.json", name))
    ]
    return {"files": rows}


def made(page: "Page") -> Taken:
    """When, by what, from which arguments, and how long it took."""
    by = page.data["made_by"]
    command = shlex.join(["diffdrive", *by["arguments"]]) if page.contents.is_command else ""
    versions = [(name, by[name]) for name in ("diffdrive", "jax", "python") if name in by]
    return {
        "date": by["date"], "command": command, "versions": versions, "seconds": page.data.get("seconds"),
        "timings": list(page.data.get("timings_s", {}).items()),
    }  # fmt: skip


def _url(name: str) -> str:
    """A relative link to a file of the folder, whatever it is called: never read as a scheme."""
    return "./" + quote(name.encode("utf-8", "surrogateescape"))


def _title(name: str) -> str:
    return readable.titled(", ".join(part for part in readable.heading(name.replace("_", " ")) if part))
