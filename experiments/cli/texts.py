"""Reference texts: printed, or written to a folder; kept from one call to the next, since to make one imports JAX."""

import contextlib
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path

import diffdrive

CATALOGUES = ("diffdrive.effects.catalogue", "diffdrive.controllers.catalogue")


def text(make: Callable[[], str], out: Path | None, name: str, what: str) -> None:
    """Print a text; with a folder, write it there as `name` instead, beside a report that says `what` it is."""
    if out is None:
        sys.stdout.write(make())
        return
    from diffdrive.support.atomic_write import write_text
    from experiments.reports.report import Report

    with Report(name, out) as report:
        write_text(out / name, make())
        report.keep("written", file=name)
        report.result(f"{name} has been written: {what}.")


def cached(make: Callable[[], str], name: str) -> str:
    """The text that `make` makes of the package's sources, or a copy of it that an earlier call kept.

    A copy is of exactly these sources, by their names, sizes and times. It is in the user's cache folder; where that
    cannot be written to, the text is made each time. So it is in a program that has the catalogues at hand already: it
    may have registered more.
    """
    if any(name in sys.modules for name in CATALOGUES):
        return make()
    import platformdirs

    from diffdrive.support.atomic_write import write_text

    folder = Path(platformdirs.user_cache_dir("diffdrive", appauthor=False)) / "texts"
    path = folder / f"{_digest(Path(diffdrive.__file__).parent)}-{name}"
    with contextlib.suppress(OSError, UnicodeDecodeError):
        return path.read_text(encoding="utf-8")
    made = make()
    with contextlib.suppress(OSError):
        folder.mkdir(parents=True, exist_ok=True)
        write_text(path, made)
    return made


def _digest(sources: Path) -> str:
    """Of what the sources are by."""
    found = [(str(path), stat.st_size, stat.st_mtime_ns) for path in sources.rglob("*.py") for stat in [path.stat()]]
    return hashlib.sha256(repr(sorted(found)).encode()).hexdigest()[:16]
