"""What a kind of controller is to a drive file.

A kind says how the table [controller] of a file becomes a controller; the controller's `table` says how it becomes
one again.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol

from diffdrive.controllers.base import Controller, Feedforward, PDGains, Tracking
from diffdrive.model.parameters import Drive
from diffdrive.support.messages import short_repr


class Section(Protocol):
    """One table of a drive file, as a kind takes keys out of it; what is left over is an error."""

    def take(self, key: str, default: Any = ...) -> Any:
        """The raw value of a key."""

    def build(self, cls: Any, **given: Any) -> Any:
        """An instance of a parameter class from its keys, beside those `given`."""

    def subsection(self, key: str) -> "Section":
        """The table below a key, empty if it is absent."""

    def fail(self, key: str, problem: str) -> Exception:
        """The error for a bad key."""

    def done(self) -> None:
        """Raise if keys are left that nobody asked for."""


class Option(NamedTuple):
    """A key of [controller] that no parameter class declares."""

    key: str
    unit: str
    range: str
    default: str
    meaning: str


FEEDFORWARD = Option(
    "feedforward", "", "true, false", "true; pd and cascade: false",
    "whether inertia and damping of [plant] are fed forward",
)  # fmt: skip
DERIVATIVE = Option("derivative", "", "backward-difference", "backward-difference", "the only one")


class Keys(NamedTuple):
    """The declared parameters of a class as keys of a table, but for those that are the plant's."""

    table: str  # "controller", or one below it
    parameters: type
    from_plant: frozenset[str] = frozenset()

    def names(self) -> Iterator[str]:
        """The keys."""
        declared = (one.name for one in dataclasses.fields(self.parameters) if "quantity" in one.metadata)
        return (name for name in declared if name not in self.from_plant)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A controller as a drive file states it: `kind = "name"`, what its table holds, and what is built of that."""

    name: str
    meaning: str
    build: Callable[[Section, Drive], Controller]
    keys: tuple[Keys, ...] = ()
    options: tuple[Option, ...] = ()

    def has(self, table: str, key: str) -> bool:
        """Whether its `table` may hold `key`."""
        below = {one.table.removeprefix("controller.") for one in self.keys if one.table != "controller"}
        own = {one.key for one in self.options} | below if table == "controller" else set()
        return key in own or any(key in keys.names() for keys in self.keys if keys.table == table)


def read_feedforward(section: Section, drive: Drive, default: bool) -> Feedforward:
    """The motion feed-forward that a table asks for: that of the drive's inertia and damping, or none."""
    wanted = section.take("feedforward", default)
    if not isinstance(wanted, bool):
        raise section.fail("feedforward", f"must be true or false, got {short_repr(wanted)}")
    return Feedforward.of(drive.plant) if wanted else Feedforward()


def read_tracking(section: Section, drive: Drive, feedforward: bool = True) -> Tracking:
    """Feedback and feed-forward of the paper's controllers, as a table states them."""
    fed = read_feedforward(section, drive, feedforward)
    derivative = section.take("derivative", DERIVATIVE.default)
    if derivative != DERIVATIVE.default:
        raise section.fail("derivative", f"only '{DERIVATIVE.default}' is known, got {short_repr(derivative)}")
    return Tracking(section.build(PDGains), fed)


TRACKING_KEYS = Keys("controller", PDGains)
TRACKING_OPTIONS = (FEEDFORWARD, DERIVATIVE)
