"""What a job's folder holds for a reader: sentences, tables, figures, the report, files."""

import contextlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from experiments.app.job import Job
from experiments.app.workspace import AppError, read_json
from experiments.reports.readable import heading, readable, shown

REPORT = "report.html"
APART = ("made_by", "timings_s", "so_far", "tables", "written", "results")  # of result.json: no numbers to be shown
MOST_ROWS = 50  # of a table on the page; the CSV file has all


@dataclass
class JobResult:
    """What is shown of a result."""

    headline: str = ""
    says: list[str] = field(default_factory=list)
    numbers: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    tables: dict[str, dict[str, Any]] = field(default_factory=dict)
    figures: list[str] = field(default_factory=list)
    report: str = ""
    files: list[tuple[str, int]] = field(default_factory=list)


def read_result(job: Job) -> JobResult:
    """The result as far as it is there; an empty one before the first file."""
    data = read_json(job.out / "result.json")
    data = data if isinstance(data, dict) else {}
    files = list_files(job.out)
    names = [name for name, _ in files]
    tables = data.get("tables")
    so_far = data.get("so_far")
    says = [str(note) for note in data.get("notes", [])]
    if not says and isinstance(so_far, dict):
        says = [str(one) for one in so_far.values()]
    says = [readable(text.strip()) for text in says if text.strip()]
    return JobResult(
        headline=_verdict(job) or _numbers_in_a_line(data.get("result")) or (says[0] if says else ""),
        says=says,
        numbers={
            name: _named(values) for name, values in data.items() if name not in APART and isinstance(values, dict)
        },
        tables={str(name): table for name, table in tables.items()} if isinstance(tables, dict) else {},
        figures=[name for name in names if name.endswith(".png")],
        report=REPORT if REPORT in names else "",
        files=files,
    )


def _numbers_in_a_line(values: object) -> str:
    """Such as the errors of a simulation."""
    pairs = _named(values) if isinstance(values, dict) else []
    return ", ".join(f"{words} {text}" for words, text in pairs)


def _named(values: dict[str, Any]) -> list[tuple[str, str]]:
    """Named numbers as a reader takes them, each with its unit."""
    found = []
    for name, value in values.items():
        words, unit = heading(str(name))
        found.append((words, f"{shown(value)} {unit}".strip() if isinstance(value, int | float) else shown(value)))
    return found


def _verdict(job: Job) -> str:
    """The verdict of a diagnosis in one sentence; its sentences begin with the size of the gap."""
    found = read_json(job.out / "diagnosis.json")
    if not isinstance(found, dict) or not found.get("says"):
        return ""
    causes = [
        f"{one['effect']}, {100.0 * float(one['confidence']):.0f} % sure"
        for one in found.get("causes") or ()
        if one.get("found")
    ]
    return f"{str(found.get('verdict', '')).upper()}: {found['says']}" + (f" ({'; '.join(causes)})" if causes else "")


def list_files(folder: Path) -> list[tuple[str, int]]:
    """The files below a folder with their sizes; hidden ones are unfinished, or parts to continue from."""
    found = []
    with contextlib.suppress(OSError):
        for path in sorted(folder.rglob("*")):
            inside = path.relative_to(folder)
            hidden = any(part.startswith(".") or part.endswith(".parts") for part in inside.parts)
            if not hidden and path.is_file() and not path.is_symlink():
                found.append((inside.as_posix(), path.stat().st_size))
    return found


def file_of(job: Job, name: str) -> Path:
    """A file of a job's results; raises `AppError` for whatever does not lie among them."""
    with contextlib.suppress(OSError, ValueError):
        path = (job.out / name).resolve(strict=True)
        hidden = any(part.startswith(".") for part in Path(name).parts)
        if path.is_relative_to(job.out.resolve()) and path.is_file() and not hidden:
            return path
    raise AppError("there is no such file here")
