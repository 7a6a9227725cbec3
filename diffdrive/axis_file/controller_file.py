"""The [controller] table of a drive file: which controller, with which gains."""

from typing import Any

from diffdrive.controllers import KINDS, Controller
from diffdrive.model.parameters import Drive
from diffdrive.support.messages import short_repr


def _kinds_with(table: str, key: str) -> list[str]:
    """The kinds of controller whose `table` may hold `key`: said of one that is left where the kind was changed."""
    return [name for name, kind in KINDS.items() if kind.has(table, key)]


def build_controller(section: Any, drive: Drive) -> Controller:
    """The controller that a `Section` describes, its model being the file's own plant and friction."""
    name = section.take("kind", None)
    if name is None:
        raise section.fail("kind", f"is missing; known: {', '.join(KINDS)}")
    if not isinstance(name, str) or name not in KINDS:
        raise section.fail("kind", f"unknown controller {short_repr(name)}; known: {', '.join(KINDS)}")
    section.set_kind(name, _kinds_with)
    return KINDS[name].build(section, drive)


def controller_table(controller: Controller) -> dict[str, Any]:
    """The [controller] table that describes this controller; raises `ParameterError` where none does."""
    return {"kind": controller.kind} | controller.table()
