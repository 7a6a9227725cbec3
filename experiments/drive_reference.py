"""Every key of a drive file, with its unit, range and meaning, as the parameter classes declare them."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from diffdrive.controllers import DOBVSC, Cascade, DisturbanceObserver, Gains, PDFeedforwardDOB
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.load_estimator import FixedLoad, InnovationLoad
from diffdrive.observer import LoadStateObserver, LoadStateTuning, Tuning
from diffdrive.parameters import Actuator, Friction, Plant, Quantity, Sensor

_TABLES: tuple[tuple[str, str, Any], ...] = (
    ("plant", "", Plant),
    ("friction", "", Friction),
    ("actuator", "", Actuator),
    ("sensor", "", Sensor),
    ("controller", "all but cascade", Gains),
    ("controller", "cascade", Cascade),
    ("controller", "dobvsc, pd+ff+dob", DisturbanceObserver),
    ("controller", "dobvsc", DOBVSC),
    ("controller", "pd+ff+dob", PDFeedforwardDOB),
    ("controller.observer", "pd+fc, pd+fc+le", Tuning),
    ("controller.observer", "pd+fc+ls", LoadStateTuning),
    ("controller.load_estimator", "pd+fc", FixedLoad),
    ("controller.load_estimator", "pd+fc+le", InnovationLoad),
    ("controller.load_estimator", "pd+fc+ls", LoadStateObserver),
    *((f"effects.{name}", "", effect) for name, effect in EFFECTS.items()),
)
_FROM_THE_PLANT = {(DisturbanceObserver, "mass"), (DisturbanceObserver, "damping")}
COLUMNS = ("table", "for kind", "key", "unit", "range", "default", "meaning")


def _range(declared: Quantity) -> str:
    signs = ((">", declared.above), (">=", declared.at_least), ("<", declared.below), ("<=", declared.at_most))
    return ", ".join(f"{sign} {bound:g}" for sign, bound in signs if bound is not None)


def _default(field: Any, declared: Quantity) -> str:
    if field.default is None:
        return "absent"
    if field.default is dataclasses.MISSING:
        return "required"
    return f"{getattr(field.default, 'positive', field.default):g}"


def reference() -> Iterator[tuple[str, ...]]:
    """Rows of `COLUMNS`, one per key."""
    for table, kind, cls in _TABLES:
        for field in dataclasses.fields(cls):
            if "quantity" not in field.metadata or (cls, field.name) in _FROM_THE_PLANT:
                continue
            declared: Quantity = field.metadata["quantity"]
            each = " (per direction)" if declared.directional else ""
            unit = "-" if declared.unit == "1" else declared.unit
            yield (
                f"[{table}]", kind, field.name, unit, _range(declared), _default(field, declared),
                declared.meaning + each,
            )  # fmt: skip


def markdown() -> str:
    """The reference as a Markdown table."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(row) + " |" for row in reference()]
    return "\n".join(lines) + "\n"
