"""The kinds of controller in a drive file.

A `Kind` builds a controller from the table [controller] of a file; the controller's `table` is the way back.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple, Protocol, TypeVar, runtime_checkable

import equinox as eqx

from diffdrive.controllers.base import Controller, Feedforward, PDGains, Tracking
from diffdrive.model.parameters import Drive
from diffdrive.support.messages import short_repr

Parameters = TypeVar("Parameters", bound=eqx.Module)


@runtime_checkable
class Section(Protocol):
    """One table of a drive file, from which a kind takes keys; a key that is left over, here or below, is an error."""

    def take(self, key: str, default: object = ...) -> object:
        """The raw value of a key."""

    def build(self, cls: type[Parameters], **values: object) -> Parameters:
        """An instance of a parameter class from its keys, beside `values`."""

    def subsection(self, key: str) -> "Section":
        """The table below a key, empty if it is absent."""

    def subsections(self, key: str) -> "Sequence[Section]":
        """The tables of an array of tables below a key, none if it is absent."""

    def fail(self, key: str, problem: str) -> Exception:
        """The error for a bad key."""

    def done(self) -> None:
        """Raise if keys are left that were never taken, here or in a table below; the file's reader asks for it."""


class Option(NamedTuple):
    """A key of [controller] that no parameter class declares."""

    key: str
    unit: str
    range: str
    default: str
    meaning: str


FEEDFORWARD = Option(
    "feedforward", "", "true, false", "false", "whether inertia and damping of [plant] are fed forward"
)
DERIVATIVE = Option("derivative", "", "backward-difference", "backward-difference", "the only one")


class Keys(NamedTuple):
    """The declared parameters of a class as keys of a table, without those taken from the plant."""

    table: str  # "controller", or one below it
    parameters: type[eqx.Module]
    from_plant: frozenset[str] = frozenset()
    kind: str = ""  # of a table that has kinds of its own, such as those of filters

    def names(self) -> Iterator[str]:
        """The keys."""
        parameters = (field.name for field in dataclasses.fields(self.parameters) if "quantity" in field.metadata)
        return (name for name in parameters if name not in self.from_plant)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of controller in a drive file: its name, the keys of its table, and the function that builds it.

    `example` makes one with gains that suit the paper's testbed: `paper_axis` and `diffdrive template` start from it.
    """

    name: str
    meaning: str
    build: Callable[[Section, Drive], Controller]
    keys: tuple[Keys, ...] = ()
    options: tuple[Option, ...] = ()
    example: Callable[[Drive], Controller] | None = None

    def has(self, table: str, key: str) -> bool:
        """Whether its `table` may hold `key`."""
        subtables = {entry.table.removeprefix("controller.") for entry in self.keys if entry.table != "controller"}
        options = {entry.key for entry in self.options} | subtables if table == "controller" else set()
        return key in options or any(key in keys.names() for keys in self.keys if keys.table == table)


def read_feedforward(section: Section, drive: Drive, default: bool) -> Feedforward | None:
    """The motion feed-forward that a table specifies: that of the drive's inertia and damping, or none."""
    enabled = section.take("feedforward", default)
    if not isinstance(enabled, bool):
        raise section.fail("feedforward", f"must be true or false, got {short_repr(enabled)}")
    return Feedforward.of(drive.plant) if enabled else None


def read_tracking(section: Section, drive: Drive, feedforward: bool = True) -> Tracking:
    """Feedback and feed-forward of the paper's controllers, as a table specifies them."""
    feedforward_part = read_feedforward(section, drive, feedforward)
    derivative = section.take("derivative", DERIVATIVE.default)
    if derivative != DERIVATIVE.default:
        raise section.fail("derivative", f"only '{DERIVATIVE.default}' is known, got {short_repr(derivative)}")
    return Tracking(section.build(PDGains), feedforward_part)


TRACKING_KEYS = Keys("controller", PDGains)
TRACKING_OPTIONS = (FEEDFORWARD._replace(default="true"), DERIVATIVE)
