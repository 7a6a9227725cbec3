"""Every key of a drive file, with its unit, range and meaning; those of parameters as their classes declare them."""

import dataclasses
from collections.abc import Container, Iterable, Iterator

import equinox as eqx

from diffdrive.controllers import KINDS, Keys
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.library.provenance import MEANINGS
from diffdrive.model.data_sheet import KINDS as AXIS_KINDS
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.parameters import Actuator, Friction, Plant, Sensor
from diffdrive.model.quantity import Quantity
from diffdrive.model.trace import Trace

_PARTS: tuple[tuple[str, type[eqx.Module]], ...] = (
    ("axis", DataSheet),
    ("plant", Plant),
    ("friction", Friction),
    ("actuator", Actuator),
    ("sensor", Sensor),
    ("motor_encoder", Sensor),
)


def _kinds_label(kinds: list[str]) -> str:
    """The kinds of controller, or "all but" the others where these are fewer."""
    others = [name for name in KINDS if name not in kinds]
    return f"all but {', '.join(others)}" if len(others) < len(kinds) else ", ".join(kinds)


def _controller_keys() -> Iterator[tuple[str, str, Keys]]:
    """Table, kinds and keys of every class of parameters that a controller has."""
    all_keys = list(dict.fromkeys(keys for kind in KINDS.values() for keys in kind.keys))
    for keys in sorted(all_keys, key=lambda keys: keys.table):
        label = keys.kind or _kinds_label([name for name, kind in KINDS.items() if keys in kind.keys])
        yield keys.table, label, keys


def _option_rows() -> Iterator[tuple[str, ...]]:
    """Rows of the keys of [controller] that no class declares."""
    for option in dict.fromkeys(option for kind in KINDS.values() for option in kind.options):
        kinds = _kinds_label([name for name, kind in KINDS.items() if option in kind.options])
        yield ("controller", kinds, *option)


# what the parameter classes do not declare: choices, whole numbers, and what is about the axis and not in its equations
_OTHER_ROWS = (
    *(("provenance", "", key, "", "text of one line", "absent", meaning) for key, meaning in MEANINGS.items()),
    ("axis", "", "kind", "", ", ".join(AXIS_KINDS), "linear", "a rotary axis has rad, N m and kg m^2 for m, N and kg"),
    ("actuator", "", "delay_samples", "-", ">= 0, whole", "0", "whole control periods between command and force"),
    ("sampling", "", "rate", "Hz", "10 to 1e6", "10000", "control rate"),
    ("sampling", "", "substeps", "-", ">= 1, whole", "of 20 us each at most", "plant steps a control period"),
    ("trace", "", "rate", "Hz", "control rate / 1, 2, 3, ...", "of the control", "rows of a log"),
    (
        "trace", "", "sample", "", "snapshot, mean", "snapshot",
        "a row's values: those of its control step, or their mean over the steps since the row before",
    ),
    (
        "trace", "", "command", "", "set-point, force", "set-point",
        "what the command column holds: the controller's command, or the force that acts (a measured current)",
    ),
    (
        "trace", "", "encoders", "", "all, scale, motor", "all",
        "whose positions are logged; motor: `position` is the motor encoder's",
    ),
    ("limits", "", "stroke", "m", "[lowest, highest]", "unlimited", "motions beyond are refused"),
    ("limits", "", "speed", "m/s", "> 0", "unlimited", "likewise"),
    ("limits", "", "acceleration", "m/s^2", "> 0", "unlimited", "likewise"),
    (
        "uncertainty", "", "path of a parameter of plant or friction", "its own, or %", "> 0; at most 100 %", "absent",
        'standard deviation: `"plant.mass" = "0.5 %"` of its value, or `"plant.constant_force" = "2 N"`',
    ),
    (
        "uncertainty.correlation", "", "path beside path", "-", "-1 to 1", "0",
        'correlation of two of them: `"plant.mass" = { "friction.viscous" = -0.3 }`',
    ),
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
COLUMNS = ("table", "for kind", "key", "unit", "range", "default", "meaning")


def _range(declared: Quantity) -> str:
    signs = ((">", declared.above), (">=", declared.at_least), ("<", declared.below), ("<=", declared.at_most))
    return ", ".join(f"{sign} {bound:g}" for sign, bound in signs if bound is not None)


def _default(field: dataclasses.Field[object], declared: Quantity) -> str:
    if field.default is None:
        return "absent"
    if field.default is dataclasses.MISSING:
        return "required"
    return f"{getattr(field.default, 'positive', field.default):g}"


def _parameter_rows(
    table: str, kind: str, cls: type[eqx.Module], names: Container[str] | None = None
) -> Iterator[tuple[str, ...]]:
    """Rows of the parameters of a class, or of those `names`."""
    for field in dataclasses.fields(cls):
        if "quantity" not in field.metadata or (names is not None and field.name not in names):
            continue
        declared: Quantity = field.metadata["quantity"]
        direction_note = " (per direction)" if declared.directional else ""
        unit = "-" if declared.unit == "1" else declared.unit.replace("*", " ")
        meaning = declared.meaning + direction_note
        yield f"[{table}]", kind, field.name, unit, _range(declared), _default(field, declared), meaning


def reference() -> Iterator[tuple[str, ...]]:
    """Rows of `COLUMNS`, one per key."""
    kinds = ", ".join(KINDS)
    first = ("controller", "", "kind", "", kinds, "required", "unknown is for identification and diagnosis")
    yield from ((f"[{table}]", *row) for table, *row in (first, *_option_rows(), *_OTHER_ROWS))
    for table, cls in _PARTS:
        yield from _parameter_rows(table, "", cls)
    yield from _parameter_rows("trace", "", Trace)
    for table, kinds, keys in _controller_keys():
        yield from _parameter_rows(table, kinds, keys.parameters, set(keys.names()))
    for name, effect in EFFECTS.items():
        yield from _parameter_rows(f"effects.{name}", "", effect)


def markdown(rows: Iterable[tuple[str, ...]] | None = None) -> str:
    """The reference, or some of its rows, as a Markdown table."""
    lines = ["| " + " | ".join(COLUMNS) + " |", "|" + "---|" * len(COLUMNS)]
    lines += ["| " + " | ".join(row) + " |" for row in (reference() if rows is None else rows)]
    return "\n".join(lines) + "\n"
