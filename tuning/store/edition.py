"""Which edition of the code answered: results of two editions do not go together."""

import contextlib
import functools
import hashlib
import inspect
import sys
import uuid
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from types import ModuleType

import diffdrive
import tuning
from diffdrive.controllers import KINDS
from diffdrive.effects.catalogue import EFFECTS
from tuning.gains.objective import AGGREGATIONS


def code_digest(*modules: str) -> str:
    """A digest of the simulator, of the tuning, of further modules by their names, and of what else is registered."""
    text = hashlib.sha256(_of_packages(*modules).encode())
    for definition in (*EFFECTS.values(), *(kind.build for kind in KINDS.values()), *AGGREGATIONS.values()):
        if definition.__module__.split(".")[0] not in (diffdrive.__name__, tuning.__name__):
            text.update(_source_of(definition).encode())
    return text.hexdigest()


@functools.cache
def _source_of(definition: Callable[..., object]) -> str:
    """The source of the module that an effect, a controller or an objective of one's own is written in.

    Where nobody can say what it is, as of what was typed, it is that of no other program.
    """
    for written in (sys.modules.get(definition.__module__), definition):
        with contextlib.suppress(OSError, TypeError):
            return inspect.getsource(written)  # type: ignore[arg-type]  # None raises what is suppressed
    return uuid.uuid4().hex


@functools.cache
def _of_packages(*modules: str) -> str:
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
