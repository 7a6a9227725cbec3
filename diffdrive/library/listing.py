"""What the library holds: its axes with their provenance, and a table of them."""

from dataclasses import dataclass
from pathlib import Path

from diffdrive.axis import Axis
from diffdrive.axis_file.drive_file import read_axis
from diffdrive.errors import DriveFileError
from diffdrive.library.provenance import Provenance
from diffdrive.library.search import library_file, library_files
from diffdrive.support.text_file import decode_text, read_toml

COLUMNS = ("name", "axis", "controller", "rate", "source")


@dataclass(frozen=True)
class LibraryAxis:
    """An axis of the library: its drive file, and where its numbers are from.

    Examples:
        >>> axes()["gantry"].read()
        Axis(600 kg, cascade, 2000 Hz)

    """

    name: str  # by which `read_axis` and every command take it
    path: Path  # of its drive file
    provenance: Provenance  # empty where the file cannot be read: `read` then says why

    def read(self) -> Axis:
        """The axis. Raises `DriveFileError`."""
        return read_axis(self.path)

    def text(self) -> str:
        """Its drive file, with the comments that say where each number is from. Raises `DriveFileError`."""
        try:
            return decode_text(self.path.read_bytes())
        except OSError as problem:
            raise DriveFileError(f"{self.path}: cannot be read: {problem.strerror}") from None


def axes() -> dict[str, LibraryAxis]:
    """The axes of the library by name, those of the package and then those of the user's folders.

    The folders are those that the environment variable `DIFFDRIVE_AXES` names, separated as those of `PATH` are, and
    `axes` in the user's configuration folder (docs/reference/axes.md). Each `.toml` file in them is an axis.

    A file that cannot be read is among them, without provenance: one that is unfinished hides no other.

    Raises:
        DriveFileError: A folder that the environment names is not there. A file that cannot be read, and a name that
            two files have, are left to `read_axis`, which refuses them: of the two, here the first has the name.

    Examples:
        >>> import diffdrive as dd
        >>> list(dd.axes())
        ['cnc', 'emps', 'gantry', 'linear', 'paper', 'vertical']
        >>> axis = dd.read_axis("gantry")

    """
    found = {}
    for name, files in library_files().items():
        try:
            found[name] = _axis_at(files[0])
        except DriveFileError:
            found[name] = LibraryAxis(name, files[0], Provenance())
    return found


def library_axis(name: str) -> LibraryAxis:
    """One of `axes`. Raises `DriveFileError` for an unknown name, and for one that two files have."""
    return _axis_at(library_file(name))


def _axis_at(path: Path) -> LibraryAxis:
    table = read_toml(path, DriveFileError, "it was there a moment ago").get("provenance", {})
    return LibraryAxis(path.stem, path, Provenance.of(table, str(path)))


def markdown() -> str:
    """The axes of the library as a Markdown table; the row of a file that is no drive file says why it is none."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    for name, files in library_files().items():
        for path in files:  # of those that share a name the source is the path, by which they differ
            cells: tuple[str, ...]
            try:
                one, axis = _axis_at(path), read_axis(path)
            except DriveFileError as problem:
                cells = (name, "cannot be read", "", "", str(problem))
            else:
                source = one.provenance.source if len(files) == 1 and one.provenance.source else str(path)
                cells = (name, one.provenance.title, axis.controller.kind, f"{1e-3 * axis.rate:g} kHz", source)
            lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"
