"""Every key of a drive file, with its unit, range and meaning; those of parameters as their classes declare them."""

import dataclasses
from collections.abc import Iterator
from typing import Any

from diffdrive.axis_file.controller_file import KINDS
from diffdrive.controllers import DOBVSC, Cascade, DisturbanceObserver, PDFeedforwardDOB, PDGains
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.model.parameters import Actuator, Friction, Plant, Quantity, Sensor
from diffdrive.observers.friction_observer import LoadStateObserver, LoadStateTuning, Tuning
from diffdrive.observers.load_estimator import FixedLoad, InnovationLoad

_TABLES: tuple[tuple[str, str, Any], ...] = (
    ("plant", "", Plant),
    ("friction", "", Friction),
    ("actuator", "", Actuator),
    ("sensor", "", Sensor),
    ("controller", "all but cascade, unknown", PDGains),
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
# what the parameter classes do not declare: choices, whole numbers, and what is about the axis and not in its equations
_OTHERS = (
    ("controller", "", "kind", "", ", ".join(KINDS), "required", "unknown is for identification and diagnosis"),
    (
        "controller", "all but unknown", "feedforward", "", "true, false", "true; pd and cascade: false",
        "whether inertia and damping of [plant] are fed forward",
    ),
    (
        "controller", "all but cascade, unknown", "derivative", "", "backward-difference", "backward-difference",
        "the only one",
    ),
    (
        "controller", "cascade", "velocity_samples", "-", ">= 1, whole", "1",
        "samples over which the velocity is differenced",
    ),
    ("actuator", "", "delay_samples", "-", ">= 0, whole", "0", "whole control periods between command and force"),
    ("sampling", "", "rate", "Hz", "10 to 1e6", "10000", "control rate"),
    ("sampling", "", "substeps", "-", ">= 1, whole", "of 20 us each at most", "plant steps a control period"),
    ("limits", "", "stroke", "m", "[lowest, highest]", "unlimited", "motions beyond are refused"),
    ("limits", "", "speed", "m/s", "> 0", "unlimited", "likewise"),
    ("limits", "", "acceleration", "m/s^2", "> 0", "unlimited", "likewise"),
    (
        "columns", "", "a channel of a log", "", "", "found by its name",
        'the column of the log\'s file that holds it: `position = "qm"`, `command = "dspace.Y.cmd"`',
    ),
    (
        "units", "", "a channel of a log", "", "", "as the file says, or SI",
        'the unit of that column, also with a factor or sign: `"mm"`, `"50 nm"`, `"-0.1 N"`',
    ),
    ("units", "", "force_per_volt", "N/V", "not 0", "absent", "for a command that is logged in V"),
    ("units", "", "force_per_ampere", "N/A", "not 0", "absent", "for a command that is logged in A"),
    (
        "shifts", "", "a channel, of one log: LOG:CHANNEL", "-", "whole", "0",
        "samples by which it is moved, positive to later times: `command = -1` for one recorded late, "
        '`"lap2:command" = -1` in lap2 alone',
    ),
)  # fmt: skip
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
    yield from ((f"[{table}]", *row) for table, *row in _OTHERS)
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
