"""Which edition of the code answered: results of two editions do not go together."""

import functools
import hashlib
import inspect
import sys
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import diffdrive
import tuning


@functools.cache
def code_digest(*modules: str) -> str:
    """A digest of the simulator, of the tuning, and of further modules by their names."""
    text = hashlib.sha256()
    for package in (diffdrive, tuning):
        root = Path(_folder(package))
        for path in sorted(root.rglob("*.py")):
            text.update(path.relative_to(root).as_posix().encode() + path.read_bytes())
    for name in ("jax", "jaxlib", "numpy", "scipy"):  # on which the last bits hang
        text.update(version(name).encode())
    for name in modules:
        text.update(inspect.getsource(sys.modules[name]).encode())
    return text.hexdigest()


def _folder(package: ModuleType) -> str:
    return next(iter(package.__path__))
