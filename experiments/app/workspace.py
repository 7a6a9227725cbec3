"""The folder of the app: files that were dropped, what was chosen for them, and the jobs. Nothing is kept elsewhere.

files/NAME            traces and drive files
mappings/NAME.json    columns and units that the user stated for a trace
looks/NAME/           the job that looks at a file
jobs/0001-diagnose/   a job: job.json, log.txt, exit.json, and out/, the folder of the command line
forms.json            what stands in the forms
"""

import contextlib
import json
import os
import shutil
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

from diffdrive.support.atomic_write import remove_temporary, temporary_beside, write_text
from experiments.app.names import numbered, safe_name

DRIVE_FILE = ".toml"
PARTS = ("files", "mappings", "looks", "jobs")


class AppError(Exception):
    """What the user reads in place of a traceback: one line, with the remedy."""


def read_json(path: Path) -> Any:
    """What a JSON file holds; None where it is absent, or where somebody broke it."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def write_json(path: Path, data: object) -> None:
    """Write a JSON file in one step: whoever reads meanwhile has the old one or the new one."""
    write_text(path, json.dumps(data) + "\n")


class Workspace:
    """The folder and its files."""

    def __init__(self, folder: Path) -> None:
        """Make the folder, private; one that is there keeps its permissions. Raises `AppError` where that cannot be."""
        self.folder = folder.resolve()
        self._lock = threading.Lock()
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            self.folder.mkdir(0o700, exist_ok=True)
            for part in PARTS:
                (self.folder / part).mkdir(exist_ok=True)
        except OSError as problem:
            raise AppError(f"--folder {folder}: cannot be used ({problem.strerror}); name another folder") from None

    def is_there(self) -> bool:
        """Whether the folder is still there: it may be deleted, or its disk taken away, while the app runs."""
        return all((self.folder / part).is_dir() for part in PARTS)

    @property
    def gone(self) -> str:
        """What is said where it is not."""
        return f"{self.folder} is gone, or a part of it: put it back, or end the app and start it again"

    def clean(self) -> None:
        """Remove what killed processes left half written; only where no other app has this folder."""
        for part in ("", "files", "mappings"):
            remove_temporary(self.folder / part)

    @property
    def files(self) -> Path:
        """The folder of the traces and drive files."""
        return self.folder / "files"

    @property
    def jobs(self) -> Path:
        """The folder of the jobs."""
        return self.folder / "jobs"

    def names(self) -> list[str]:
        """The files, by name; what was put there by other means has to have a name that the app would give it."""
        found = (one for one in self.files.iterdir() if one.name == safe_name(one.name) and one.is_file())
        return sorted((one.name for one in found if not one.is_symlink()), key=str.casefold)

    def file(self, name: str) -> Path:
        """A file by its name; raises `AppError` where there is none, and for whatever is no name of one."""
        if name != safe_name(name) or not (self.files / name).is_file() or (self.files / name).is_symlink():
            raise AppError(f"there is no file '{name[:100]}' here")
        return self.files / name

    @contextlib.contextmanager
    def adding(self, wanted: str) -> Iterator[tuple[IO[bytes], list[str]]]:
        """Yield a file to write to, and a list that has the name it got at the end of the block.

        It is there as a whole or not at all. One of that name stays: the new one gets a number.
        """
        name = safe_name(wanted)
        temporary = temporary_beside(self.files / name)
        given: list[str] = []
        try:
            with temporary.open("xb") as file:
                yield file, given
                file.flush()
                os.fsync(file.fileno())
            with self._lock:  # two tabs may send the same name at once
                free, number = name, 1
                while (self.files / free).exists():
                    number += 1
                    free = numbered(name, number)
                temporary.replace(self.files / free)
            given.append(free)
        finally:
            temporary.unlink(missing_ok=True)

    def add(self, name: str, content: bytes) -> str:
        """Keep a file; its name, which has a number where there was one of that name."""
        with self.adding(name) as (file, given):
            file.write(content)
        return given[0]

    def remove(self, name: str) -> None:
        """Remove a file, and what was known of it; results of jobs stay."""
        path = self.file(name)
        path.unlink()
        self.mapping_file(name).unlink(missing_ok=True)
        shutil.rmtree(self.look_folder(name), ignore_errors=True)

    def look_folder(self, name: str) -> Path:
        """The folder of the job that looks at a file."""
        return self.folder / "looks" / name

    def mapping_file(self, name: str) -> Path:
        """Where the columns and units are kept that the user stated for a trace."""
        return self.folder / "mappings" / f"{name}.json"

    def path(self, text: str) -> Path:
        """A file of the workspace by its path in it; raises `AppError` for anything else."""
        there = self.folder / text
        with contextlib.suppress(OSError, ValueError):
            real = there.resolve(strict=True)
            hidden = any(part.startswith(".") for part in Path(text).parts)
            if real.is_relative_to(self.folder) and real.is_file() and not hidden and not Path(text).is_absolute():
                return real
        raise AppError(f"there is no file '{text[:100]}' here; choose another")

    def drive_files(self) -> list[str]:
        """Drive files that were dropped, and those that jobs wrote, as paths in the workspace, the newest job first."""
        dropped = [f"files/{name}" for name in self.names() if name.casefold().endswith(DRIVE_FILE)]
        made = [path for path in self.jobs.glob("*/out/*.toml") if path.name not in NO_DRIVE_FILES]
        made.sort(key=lambda path: (path.parent.parent.name, path.name), reverse=True)
        return [*dropped, *(path.relative_to(self.folder).as_posix() for path in made)]

    def traces(self) -> list[str]:
        """Traces that were dropped, and logs that jobs simulated."""
        dropped = [f"files/{name}" for name in self.names() if not name.casefold().endswith(DRIVE_FILE)]
        made = sorted(self.jobs.glob("*-simulate/out/run.csv"), reverse=True)
        return [*dropped, *(path.relative_to(self.folder).as_posix() for path in made)]

    def form(self, command: str) -> dict[str, Any]:
        """What stands in the form of a command."""
        forms = read_json(self.folder / "forms.json")
        kept = forms.get(command) if isinstance(forms, dict) else None
        return kept if isinstance(kept, dict) else {}

    def keep_form(self, command: str, values: dict[str, Any]) -> None:
        """Keep what stands in a form: a reload shows it again."""
        with self._lock:
            forms = read_json(self.folder / "forms.json")
            write_json(self.folder / "forms.json", (forms if isinstance(forms, dict) else {}) | {command: values})


NO_DRIVE_FILES = ("uncertainty.toml", "handover.toml")  # what commands write beside drive files
