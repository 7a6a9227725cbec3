"""What is in a file that was dropped: columns, first rows, a preview, and the guess of what is what."""

import contextlib
import sys
from pathlib import Path
from typing import Any

import numpy as np

from experiments.app.workspace import DRIVE_FILE, write_json

ROWS = 5  # that are shown of the beginning
POINTS = 400  # pairs of least and greatest that a curve is drawn of: more than a page has pixels for
CURVES = 40  # columns that are drawn; a list of more is not looked through by eye
LOOK = "look.json"


def look_at(path: Path, out: Path) -> None:
    """Write look.json into `out`: at first what the file holds, then with what was guessed of it.

    A file that cannot be read raises `DiffdriveError`, one line; here it is printed as the command line prints it.
    """
    from diffdrive.errors import DiffdriveError
    from diffdrive.runtime import configure

    configure()
    out.mkdir(parents=True, exist_ok=True)
    try:
        if path.suffix.casefold() == DRIVE_FILE:
            write_json(out / LOOK, look_at_drive(path))
        else:
            _look_at_trace(path, out)
    except DiffdriveError as problem:
        print(f"error: {problem}", flush=True)
        sys.exit(2)


def look_at_drive(path: Path) -> dict[str, Any]:
    """What a drive file says, in short."""
    from diffdrive.axis_file.drive_file import read_axis

    axis = read_axis(path)
    return {"kind": "drive", "says": str(axis).splitlines()[:12]}


def _look_at_trace(path: Path, out: Path) -> None:
    from diffdrive.errors import LogError
    from diffdrive.logs.guess.trace import guess_trace
    from diffdrive.logs.read import table_of

    table = table_of(path)
    found: dict[str, Any] = {
        "kind": "trace",
        "rows": max((len(values) for values in table.columns.values()), default=0),
        "columns": [_column(table, name, k < CURVES) for k, name in enumerate(table.columns)],
        "notes": list(table.notes),
    }
    write_json(out / LOOK, found | {"guessing": True})
    try:
        guess = guess_trace(table)
        found |= {
            "chosen": guess.columns,
            "units": guess.units,
            "guesses": [one._asdict() for one in guess.guesses],
            "questions": [one._asdict() | {"option": one.option} for one in guess.questions],
            "notes": [*found["notes"], *guess.notes],
        }
    except LogError as problem:  # the columns may be stated by hand all the same
        found["notes"] = [*found["notes"], str(problem)]
    write_json(out / LOOK, found)


def _column(table: Any, name: str, drawn: bool) -> dict[str, Any]:
    """One column: the first cells as they are, the unit that the file states, and its course."""
    from diffdrive.errors import LogError
    from diffdrive.logs.guess.units import stated_unit

    described: dict[str, Any] = {
        "name": name,
        "unit": stated_unit(table, name).unit,
        "first": [_cell(cell) for cell in table.columns[name][:ROWS]],
        "curve": None,
    }
    if drawn:
        with contextlib.suppress(LogError):  # text
            described["curve"] = curve(table.numbers(name))
    return described


def _cell(cell: Any) -> str:
    return f"{cell:.6g}" if isinstance(cell, float | np.floating) else str(cell)[:60]


def curve(values: np.ndarray) -> list[list[float]] | None:
    """The least and the greatest of each of `POINTS` stretches: no peak is lost, however long the trace is."""
    values = values[np.isfinite(values)]
    if not len(values):
        return None
    edges = np.linspace(0, len(values), min(POINTS, len(values)) + 1).astype(int)[:-1]
    least, greatest = np.minimum.reduceat(values, edges), np.maximum.reduceat(values, edges)
    return [[float(f"{low:.6g}"), float(f"{high:.6g}")] for low, high in zip(least, greatest, strict=True)]
