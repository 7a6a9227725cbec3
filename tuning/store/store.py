"""Finished pieces of a long computation, found again by a digest of all that they follow from.

The computation repeats itself to the last bit. So one that was stopped and is begun again, and finds its dear pieces
finished, ends with the same numbers as one that was not stopped, and no piece is ever mistaken for another's.
"""

import dataclasses
import enum
import hashlib
from collections.abc import Callable
from types import FunctionType
from typing import Protocol, cast, runtime_checkable

import jax
import numpy as np

Arrays = dict[str, np.ndarray]


@runtime_checkable
class Store(Protocol):
    """Where pieces are kept, each under its key; threads use it side by side."""

    def read(self, key: str) -> Arrays | None:
        """The piece of that key, to the last bit; None where there is none."""

    def write(self, key: str, piece: Arrays) -> None:
        """Keep a piece."""


def digest(*inputs: object) -> str:
    """A digest of every number, name and setting in `inputs`. Raises `TypeError` for what it cannot tell apart."""
    found = hashlib.blake2b(digest_size=20)
    _feed(found.update, inputs)
    return found.hexdigest()


def _feed(update: Callable[[bytes | memoryview], object], value: object) -> None:
    if isinstance(value, np.ndarray | np.generic | jax.Array):
        array = np.asarray(value)
        update(f"{array.dtype.str}{array.shape}".encode())
        if array.size:
            update(np.ascontiguousarray(array).data)
    elif value is None or isinstance(value, bool | int | float | str):
        update(f"{type(value).__name__} {value!r};".encode())
    elif isinstance(value, enum.Enum):
        update(f"enum {type(value).__module__}.{value};".encode())
    elif isinstance(value, type):
        update(f"type {value.__module__}.{value.__qualname__};".encode())
    elif isinstance(value, tuple | list):
        update(f"{type(value).__qualname__} {len(value)};".encode())
        for item in value:
            _feed(update, item)
    elif isinstance(value, dict):
        update(f"dict {len(value)};".encode())
        for item in value.items():
            _feed(update, item)
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = tuple((field.name, getattr(value, field.name)) for field in dataclasses.fields(value))
        _feed(update, (type(value), fields))
    elif isinstance(value, np.ufunc):
        update(f"ufunc {value.__name__};".encode())
    elif callable(value) and hasattr(value, "__code__") and not getattr(value, "__closure__", None):
        function = cast(FunctionType, value)
        code = function.__code__
        update(f"function {function.__module__}.{function.__qualname__} {code.co_consts!r} {code.co_names!r};".encode())
        update(code.co_code)
    else:
        raise TypeError(f"no digest of a {type(value).__qualname__}")
