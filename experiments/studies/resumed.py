"""A study of several machines that goes on from what it has: one line of JSON for each."""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import TypeVar

from diffdrive.errors import DiffdriveError
from diffdrive.support.atomic_write import write_text

T = TypeVar("T", bound=Mapping[str, object])


def resumed(out: Path | None, cases: Iterable[str], study: Callable[[str], T]) -> Iterator[T]:
    """What `study` has of each case, by its `case`; those in `out` are not studied again, one that fails is said."""
    done: dict[str, T] = {}
    if out is not None and out.exists():
        done = {one["case"]: one for one in map(json.loads, out.read_text(encoding="utf-8").splitlines())}
    for name in cases:
        if name not in done:
            try:
                done[name] = study(name)
            except DiffdriveError as error:
                print(f"{name}: {error}", flush=True)
                continue
            if out is not None:
                write_text(out, "".join(json.dumps(one) + "\n" for one in done.values()))
        yield done[name]
