"""Where an axis is found by its name: with the package, in the folders that a user names, in the user's own one."""

import os
from pathlib import Path

import platformdirs

from diffdrive.errors import DriveFileError
from diffdrive.library import OWN_FOLDER
from diffdrive.support.messages import shortened, suggestion

FOLDERS = "DIFFDRIVE_AXES"  # environment variable: folders, separated as those of PATH are
SUFFIX = ".toml"


def folders() -> tuple[Path, ...]:
    """The folders of the library.

    Raises `DriveFileError` where the environment names one that is not there: what is in it would be missed in silence.
    """
    named = [Path(text) for text in os.environ.get(FOLDERS, "").split(os.pathsep) if text.strip()]
    for folder in named:
        if not folder.is_dir():
            raise DriveFileError(f"{FOLDERS}: {folder}: no such folder; make it, or take it out of the variable")
    own = Path(platformdirs.user_config_dir("diffdrive", appauthor=False)) / "axes"
    unique = {folder.resolve(): folder for folder in (OWN_FOLDER, *named, own) if folder.is_dir()}
    return tuple(unique.values())


def library_files() -> dict[str, list[Path]]:
    """The drive files of the library by the names of their axes: one each, or several that share a name."""
    found: dict[str, list[Path]] = {}
    for folder in folders():
        for path in sorted(folder.glob(f"*{SUFFIX}")):
            if not path.name.startswith("."):
                found.setdefault(path.stem, []).append(path)
    return found


def library_file(name: str, otherwise: str = "no axis of the library") -> Path:
    """The drive file of an axis. Raises `DriveFileError` for an unknown name, and for one that two files have."""
    known = library_files()
    files = known.get(name, [])
    if not files:
        raise DriveFileError(f"{shortened(name)}: {otherwise}; {suggestion(name.casefold(), known)}")
    if len(files) > 1:
        raise DriveFileError(
            f"{name}: {len(files)} axes of the library have this name; write which: {' or '.join(map(str, files))}"
        )
    return files[0]


def drive_path(given: str | Path) -> Path:
    """The drive file that is meant: a file that exists, else the axis of the library of this name.

    A name is a text without folder and without `.toml`. A folder of that name does not keep the axis from being found:
    it may be what an earlier `--out` made. What is no name is returned as it is. Raises `DriveFileError`.
    """
    path = Path(given)
    text, is_folder = str(path), os.path.isdir(path)
    if path.name != text or (os.path.exists(path) and not is_folder):
        return path
    known = library_files()
    if path.suffix.casefold() == SUFFIX:
        if path.stem in known and not is_folder:
            raise DriveFileError(f"{text}: no such file; '{path.stem}' without {SUFFIX} is an axis of the library")
        return path
    if is_folder and text not in known:
        return path
    return library_file(text, "no such file, and no axis of the library")
