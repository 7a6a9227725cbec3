"""Drive files to begin with: the template, and the axes of the library."""

from pathlib import Path

from diffdrive.errors import DriveFileError
from diffdrive.library.search import library_file, library_files
from diffdrive.support.text_file import read_toml
from experiments.app.workspace import AppError

TEMPLATE = "drive"


def drive_files() -> dict[str, str]:
    """What there is to begin with, by name, each in a line."""
    found = {TEMPLATE: "the template: a testbed with comments on every key"}
    try:
        return found | {name: _title(files[0]) for name, files in library_files().items()}
    except DriveFileError:  # a folder of the user's that is not there; the command line says so
        return found


def _title(path: Path) -> str:
    # not diffdrive.axes(), which reads the axis and so imports JAX: half a second for a list of names
    try:
        provenance = read_toml(path, DriveFileError, "it was there a moment ago").get("provenance", {})
    except DriveFileError:
        return "cannot be read; diffdrive axes says why"
    return str(provenance.get("title", "")) if isinstance(provenance, dict) else ""


def drive_file(name: str) -> bytes:
    """The drive file of that name; raises `AppError` where there is none."""
    if name == TEMPLATE:
        from experiments.cli.template import template

        return template("pd+fc+ls").encode()
    try:
        return library_file(name).read_bytes()
    except (DriveFileError, OSError) as problem:
        raise AppError(str(problem)) from None
