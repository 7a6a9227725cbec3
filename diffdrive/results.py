"""What all results have in common: a status, a short form, a summary, and a JSON file."""

import abc
import html
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np

from diffdrive.errors import DivergenceError, ResultError
from diffdrive.support.atomic_write import write_text


@dataclass(frozen=True)
class Status:
    """Whether to believe a result: `ok`, a `code` for programs, and a `message` for people.

    A failed simulation also has the signal that left its bounds, and when (s).
    """

    ok: bool
    message: str = "ok"
    signal: str | None = None
    time: float | None = None
    code: str = "ok"


AnyResult = TypeVar("AnyResult", bound="Result")


class Result(abc.ABC):
    """A result: `repr` is the short form, `summary()` has more, `save()` writes JSON, `require_ok()` raises."""

    schema: ClassVar[str]  # name and version of what `as_dict` holds
    status: Status
    notes: tuple[str, ...]  # what a reader should know before trusting the numbers

    @abc.abstractmethod
    def headline(self) -> str:
        """One line: whether to believe it, and the numbers that matter most."""

    def summary(self) -> str:
        """The findings and their evidence, in lines of at most 100 characters."""
        return self.headline()

    @abc.abstractmethod
    def as_dict(self) -> dict[str, object]:
        """Every number, by names that carry their unit."""

    def save(self, folder: str | Path) -> Path:
        """Write it as JSON, with the version of its schema, into a folder; returns the file."""
        kind = self.schema.split("/")[0]
        path = Path(folder) / f"{kind}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(as_json(self.document()), indent=2, allow_nan=False) + "\n")
        return path

    def document(self) -> dict[str, object]:
        """What `save` writes: the schema, the status and the notes, then `as_dict`."""
        head = {"schema": self.schema, "status": asdict(self.status), "notes": list(self.notes)}
        return head | self.as_dict()

    def require_ok(self: AnyResult) -> AnyResult:
        """The result itself; raises `ResultError` where it is not ok, `DivergenceError` where a loop diverged.

        The error has the message of the status, and the `result`.
        """
        if not self.status.ok:
            error = DivergenceError if self.status.code == "diverged" else ResultError
            raise error(self.status.message, self)
        return self

    def __repr__(self) -> str:
        return self.headline()

    def __str__(self) -> str:
        return self.summary()

    def _repr_html_(self) -> str:
        return f"<pre>{html.escape(self.summary())}</pre>"


def _null(number: float) -> None:
    """What an infinite or undefined number becomes in the file of a result."""


def as_json(value: object, not_finite: Callable[[float], object] = _null) -> object:
    """The value as JSON can hold it; infinite and undefined numbers, which it has not, become null, or `not_finite`."""
    if isinstance(value, Mapping):
        return {str(key): as_json(item, not_finite) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [as_json(item, not_finite) for item in value]
    if isinstance(value, np.ndarray) or hasattr(value, "__jax_array__") or type(value).__module__.startswith("jax"):
        return as_json(np.asarray(value).tolist(), not_finite)
    if isinstance(value, np.generic):
        return as_json(value.item(), not_finite)
    if isinstance(value, float) and not math.isfinite(value):
        return not_finite(value)
    return value
