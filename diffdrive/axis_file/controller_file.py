"""The [controller] table of a drive file: which controller, with which gains."""

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from diffdrive.controllers import KINDS, Controller
from diffdrive.controllers.kinds import Section
from diffdrive.model.parameters import Drive
from diffdrive.support.messages import short_repr
from diffdrive.support.typing import TomlTable


@runtime_checkable
class ControllerSection(Section, Protocol):
    """The section [controller], whose keys depend on the kind."""

    def set_kind(self, kind: str, kinds_with: Callable[[str, str], list[str]]) -> None:
        """Set the kind, and the function from table and key to the kinds that accept it."""


def _kinds_with(table: str, key: str) -> list[str]:
    """The kinds of controller whose `table` may hold `key`, for the message about a key of another kind."""
    return [name for name, kind in KINDS.items() if kind.has(table, key)]


def build_controller(section: ControllerSection, drive: Drive) -> Controller:
    """The controller that a `Section` specifies; its model is the file's own plant and friction."""
    name = section.take("kind", None)
    if name is None:
        raise section.fail("kind", f"is missing; known: {', '.join(KINDS)}")
    if not isinstance(name, str) or name not in KINDS:
        raise section.fail("kind", f"unknown controller {short_repr(name)}; known: {', '.join(KINDS)}")
    section.set_kind(name, _kinds_with)
    return KINDS[name].build(section, drive)


def controller_table(controller: Controller) -> TomlTable:
    """The [controller] table of this controller; raises `ParameterError` if no table can state it."""
    return {"kind": controller.kind} | controller.table()
