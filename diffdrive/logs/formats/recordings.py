"""Tables of files that keep channels in groups, each with time stamps of its own."""

import re
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from diffdrive.logs.formats.table import Table, skipped_note
from diffdrive.support.messages import quoted_names, shortened


@dataclass
class Recording:
    """Channels of one clock: the group's name, its time stamps if it has any, their unit, and values by column."""

    name: str
    times: np.ndarray | None
    columns: dict[str, np.ndarray] = field(default_factory=dict)
    unit: str = "s"


def table_of(
    source: str,
    recordings: Iterable[Recording],
    units: dict[str, str],
    skipped: dict[str, str],
    notes: tuple[str, ...] = (),
) -> Table:
    """One table of all recordings: the clock of the fullest is `time`, the clock of any other `NAME.clock`.

    Clocks that tick alike are one. A recording that brings a column `time` of its own keeps it: then its clock, too, is
    `NAME.clock`. Which clocks agree is checked where channels are chosen.
    """
    merged = _merged(recordings)
    ordered = sorted(merged, key=lambda one: -sum(map(len, one.columns.values())))  # stable: the first of equals
    columns = {name: values for one in merged for name, values in one.columns.items()}
    clocked = [one for one in ordered if one.times is not None]
    clocks: dict[str, str] = {}
    named: list[str] = []
    for k, one in enumerate(clocked):
        assert one.times is not None
        own = any(_is_time(name) for name in one.columns) or "time" in columns
        name = "time" if k == 0 and not own else _free(f"{one.name}.clock", columns)
        columns[name] = one.times
        units = units | {name: one.unit}
        clocks |= dict.fromkeys(one.columns, name)
        named.append(name)
    if len(clocked) > 1:
        main = clocked[0]
        samples = 0 if main.times is None else len(main.times)
        notes = (
            f"channels of {len(clocked)} clocks: '{named[0]}' is that of '{shortened(main.name)}', with "
            f"{len(main.columns)} channels of {samples} samples; the others are {quoted_names(named[1:])}",
            *notes,
        )
    return Table(
        source, columns, units, notes=(*notes, *skipped_note(skipped)),
        clocks=clocks if len(clocked) > 1 else {}, skipped=skipped,
    )  # fmt: skip


def unique_names(pairs: Iterable[tuple[str, str]]) -> list[str]:
    """Names of channels in groups, (group, name): the name alone where it is the only one, else 'group/name'."""
    listed = list(pairs)
    total, seen = Counter(name for _, name in listed), Counter[str]()
    full = [name if total[name] == 1 else f"{group}/{name}" for group, name in listed]
    repeated, unique = Counter(full), list[str]()
    for name in full:
        seen[name] += 1
        unique.append(name if repeated[name] == 1 else f"{name}#{seen[name]}")
    return unique


def _merged(recordings: Iterable[Recording]) -> list[Recording]:
    merged: list[Recording] = []
    for one in recordings:
        same = next((other for other in merged if _same_clock(one, other)), None)
        if same is None:
            merged.append(Recording(one.name, one.times, dict(one.columns), one.unit))
        else:
            same.columns |= one.columns
    return [one for one in merged if one.columns]


def _same_clock(one: Recording, other: Recording) -> bool:
    if one.times is None or other.times is None:
        return one.times is other.times
    return one.unit == other.unit and np.array_equal(one.times, other.times)


def _is_time(name: str) -> bool:
    return re.split(r"[./]", name.strip().casefold())[-1] == "time"


def _free(name: str, taken: dict[str, np.ndarray]) -> str:
    k, free = 1, name
    while free in taken:
        k += 1
        free = f"{name}#{k}"
    return free
