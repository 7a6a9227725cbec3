"""Libraries that only some formats need: imported when a file asks for them, quiet, named where missing."""

import importlib
import io
import logging
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from pathlib import Path
from types import ModuleType

from diffdrive.errors import LogError


def require(module: str, path: Path, what: str) -> ModuleType:
    """The module that reads `what`; raises `LogError` that says how to install it where it is missing."""
    with quiet():
        try:
            return importlib.import_module(module)
        except ImportError as error:
            raise LogError(
                f"{path}: reading {what} needs a package that is not installed here ({first_line(error)}): "
                "pip install 'diffdrive[formats]'"
            ) from None


@contextmanager
def quiet() -> Iterator[None]:
    """What a library warns, logs or prints is no message of ours: it says nothing that an engineer could act upon."""
    level, hook = logging.root.manager.disable, sys.unraisablehook
    logging.disable(logging.CRITICAL)
    sys.unraisablehook = lambda _: None
    try:
        with warnings.catch_warnings(), redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            yield
    finally:
        logging.disable(level)
        sys.unraisablehook = hook


def unreadable(path: Path, what: str, problem: str) -> LogError:
    """The error for a file that its library cannot read."""
    return LogError(
        f"{path}: cannot be read as {what}, it is another format or cut off ({problem}); export or copy it again"
    )


def first_line(error: Exception) -> str:
    """What an error says, on one line."""
    return (str(error).strip() or type(error).__name__).splitlines()[0]
