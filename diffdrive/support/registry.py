"""What is known by name, and what programs add to it: one rule for all that can be extended."""

import re
from collections.abc import Iterator, Mapping
from typing import Generic, TypeVar

from diffdrive.errors import ParameterError
from diffdrive.support.messages import short_repr

Item = TypeVar("Item")


class Registry(Mapping[str, Item], Generic[Item]):
    """Items by name: those that the package has, which nobody replaces, and then those that programs add.

    An item that was added is replaced, in its place, by one that is added under its name: a cell of a notebook may run
    again. `noun` is what messages call an item; a name matches `pattern`, which `hint` puts into words.
    """

    def __init__(
        self,
        noun: str,
        built_in: Mapping[str, Item] | None = None,
        *,
        pattern: str = r"\S(.*\S)?",
        hint: str = "printable, and without spaces at its ends",
    ) -> None:
        self._noun, self._pattern, self._hint = noun, re.compile(pattern), hint
        self._built_in: dict[str, Item] = dict(built_in or {})
        self._added: dict[str, Item] = {}

    def add(self, name: str, item: Item) -> None:
        """Make an item known by `name`; raises `ParameterError` for one that the package has, and for a bad name."""
        if not isinstance(name, str) or not name.isprintable() or not self._pattern.fullmatch(name):
            raise ParameterError(f"{self._noun} {short_repr(name)}: its name must be {self._hint}")
        if name in self._built_in:
            raise ParameterError(f"{self._noun} '{name}': there is one of this name; choose another")
        self._added[name] = item

    def remove(self, name: str) -> None:
        """Forget what was added as `name`; raises `ParameterError` for anything else."""
        if name not in self._added:
            raise ParameterError(f"{self._noun} {short_repr(name)}: is not yours to remove")
        del self._added[name]

    def __getitem__(self, name: str) -> Item:
        return self._built_in[name] if name in self._built_in else self._added[name]

    def __iter__(self) -> Iterator[str]:
        yield from self._built_in
        yield from self._added

    def __len__(self) -> int:
        return len(self._built_in) + len(self._added)

    def __repr__(self) -> str:
        return f"Registry({self._noun}: {', '.join(self)})"
