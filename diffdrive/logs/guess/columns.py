"""The columns of a trace beside its time: what their headers say, and which of them move together."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from diffdrive.errors import LogError
from diffdrive.logs.formats.table import Table
from diffdrive.logs.guess.evidence import Recording, recording_of
from diffdrive.logs.guess.names import Words, words_of
from diffdrive.logs.guess.units import Stated, stated_unit
from diffdrive.logs.log import Signal

Kind = str  # position, velocity, force, load, temperature, time, error, other, index; "" where the header says nothing
# what is none of a log's signals, whatever its unit
_NO_SIGNAL = ("error", "other", "index")
_KIND_OF_UNIT = {
    "position": "position", "velocity": "velocity", "command": "force", "current": "force",
    "temperature": "temperature", "time": "time",
}  # fmt: skip
_KIND_OF_NAME = {"force": "force", "current": "force"}


class Column(NamedTuple):
    """One column: its name in the file, what the name says, and the unit that the file states."""

    name: str
    words: Words
    stated: Stated

    @property
    def kind(self) -> Kind:
        """What it may be a signal of, the unit before the name."""
        quantity = self.words.quantity
        if quantity in _NO_SIGNAL:
            return str(quantity)
        if quantity == "load" and (not self.stated.kinds or "command" in self.stated.kinds):
            return "load"
        if self.stated.kinds:
            return _KIND_OF_UNIT[self.stated.kinds[0]]
        return _KIND_OF_NAME.get(str(quantity), str(quantity or ""))


def read_columns(table: Table, time: str | None, times: Signal, period: float) -> tuple[dict[str, Column], Recording]:
    """The columns that hold numbers, as many as there are times, and change; and what they hold."""
    numbers: dict[str, Signal] = {}
    for name in table.columns:
        if name == time or name in table.clocks.values() or len(table.columns[name]) != len(times):
            continue
        try:
            numbers[name] = table.numbers(name)
        except LogError:  # text, which is no signal
            continue
    recording = recording_of(numbers, times, period)
    described = {name: stated_unit(table, name) for name in recording.columns}
    return {name: Column(name, words_of(stated.name), stated) for name, stated in described.items()}, recording


def groups_of(recording: Recording, names: Iterable[str]) -> list[list[str]]:
    """The names, those that are one motion together."""
    groups: list[list[str]] = []
    for name in names:
        group = next((one for one in groups if recording.slope(name, one[0]) is not None), None)
        if group is None:
            groups.append([name])
        else:
            group.append(name)
    return groups


def of_kind(columns: dict[str, Column], *kinds: Kind) -> list[str]:
    """The names of the columns of these kinds, in the order of the file."""
    return [name for name, column in columns.items() if column.kind in kinds]


def may_be_forces(columns: dict[str, Column], recording: Recording, position: str) -> list[str]:
    """Those called a force, torque or current; where none is, those of no kind that are no motion of the position."""
    named = [name for name in of_kind(columns, "force") if columns[name].words.role != "feedforward"]
    return named or _no_motion(recording, of_kind(columns, ""), position)


def _no_motion(recording: Recording, names: Sequence[str], position: str) -> list[str]:
    return [
        name
        for name in names
        if name != position
        and recording.slope(name, position) is None
        and recording.slope_of_velocity(name, position) is None
    ]
