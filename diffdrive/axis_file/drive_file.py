"""Drive files: the nominal axis, as TOML in SI units or with units spelled out.

    [plant]       mass = 100.0              or  mass = "100 kg"
                  damping = [380.0, 260.0]      one value per direction: [positive, negative]

Tables and keys are those of the parameter classes; `diffdrive template` prints a complete file. Anything unknown is an
error, because a misspelt key that is silently ignored is a wrong simulation.
"""

import dataclasses
import difflib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import cast

import jax
import numpy as np
import tomli_w

from diffdrive.axis import Axis
from diffdrive.axis_file.controller_file import build_controller, controller_table
from diffdrive.controllers.base import require_rate
from diffdrive.controllers.kinds import Parameters
from diffdrive.effects.base import Effect
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.data_sheet import require_agreement, stated_parameters, without_contradicted
from diffdrive.effects.feasibility import limits_envelope, require_feasible
from diffdrive.errors import DriveFileError, LogError, ParameterError
from diffdrive.logs.mapping import mapping_tables, parse_mapping
from diffdrive.model.data_sheet import KINDS as AXIS_KINDS
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.motor_units import axis_unit, to_axis_si
from diffdrive.model.parameters import Actuator, Drive, Friction, Plant, Sampling, Sensor, check_drive
from diffdrive.model.quantity import Directional, Quantity, check, quantity_table
from diffdrive.model.trace import CHOICES, Trace, check_trace
from diffdrive.motion.motion import Limits
from diffdrive.support.atomic_write import write_text
from diffdrive.support.messages import short_repr, shortened
from diffdrive.support.text_file import read_toml
from diffdrive.support.typing import TomlTable
from diffdrive.support.units import in_unit

LIGHTEST_ROTOR = 0.9  # of its inertia on the data sheet, which is stated to 10 %


class TomlSection:
    """One table of a drive file; takes keys out one by one and raises for those that are left."""

    def __init__(self, source: str, name: str, table: object, sheet: DataSheet = NO_SHEET) -> None:
        if not isinstance(table, dict):
            raise DriveFileError(f"{source}: [{name}] must be a table, got {short_repr(table)}")
        self.source, self.name, self.table, self._remaining = source, name, table, dict(table)
        self.sheet = sheet  # by which units of the motor are read
        self._accepted: list[str] = []
        self._below: list[TomlSection] = []
        self.kind: str | None = None  # of the controller, where the accepted keys depend on it
        self.kinds_with: Callable[[str], list[str]] = lambda key: []  # the other kinds that accept a key

    def fail(self, key: str, problem: str) -> DriveFileError:
        """The error for a bad `key`."""
        return DriveFileError(f"{self.source}: [{self.name}] {shortened(key)}: {problem}")

    def take(self, key: str, default: object = dataclasses.MISSING) -> object:
        """The raw value of `key`, or the default."""
        self._accepted.append(key)
        if key not in self._remaining:
            if default is dataclasses.MISSING:
                raise self.fail(key, "is missing")
            return default
        return self._remaining.pop(key)

    def subsection(self, key: str) -> "TomlSection":
        """The table below `key`, empty if it is absent."""
        subsection = TomlSection(self.source, f"{self.name}.{key}", self.take(key, {}), self.sheet)
        if self.kind is not None:
            subsection.set_kind(self.kind, self._kinds_of_table)
        self._below.append(subsection)
        return subsection

    def subsections(self, key: str) -> "list[TomlSection]":
        """The tables of the array of tables below `key`, none if it is absent."""
        tables = self.take(key, [])
        if not isinstance(tables, list):
            raise self.fail(key, f"must be an array of tables, [[{self.name}.{key}]], got {short_repr(tables)}")
        return [TomlSection(self.source, f"{self.name}.{key}.{k}", table) for k, table in enumerate(tables, 1)]

    def set_kind(self, kind: str, kinds_with: Callable[[str, str], list[str]]) -> None:
        """Set the controller's kind, and the function from table and key to the kinds that accept it."""
        self.kind, self._kinds_of_table = kind, kinds_with
        self.kinds_with = lambda key: kinds_with(self.name, key)

    def number(self, key: str, unit: str, default: object = dataclasses.MISSING) -> float:
        """A number in SI, converted from a string with a unit where one is given."""
        return self._number(key, self.take(key, default), unit)

    def _number(self, key: str, value: object, unit: str) -> float:
        if isinstance(value, bool) or not isinstance(value, int | float | str):
            own = axis_unit(unit, self.sheet)
            or_text = "" if unit == "1" else f', or a string such as "1.5 {own}"'
            raise self.fail(key, f"must be a number{in_unit(own)}{or_text}, got {short_repr(value)}")
        if not isinstance(value, str):
            try:
                return float(value)
            except OverflowError:
                raise self.fail(key, f"{short_repr(value)} is larger than any number of double precision") from None
        try:
            return to_axis_si(value, unit, self.sheet)
        except ValueError as problem:
            raise self.fail(key, str(problem)) from None

    def quantity(self, key: str, declared: Quantity, default: object) -> object:
        """The value of one declared parameter: a number, or a pair where it may differ by direction."""
        if default is dataclasses.MISSING and key not in self._remaining:
            close = difflib.get_close_matches(key, self._remaining, n=1)
            hint = f"; is it meant by '{close[0]}'?" if close else ""
            unit = in_unit(axis_unit(declared.unit, self.sheet)) or " a number"
            raise self.fail(key, f"is missing: give the {declared.meaning},{unit}{hint}")
        value = self.take(key, default)
        if value is default:
            return value
        if value == "none" and declared.optional:
            return None
        if isinstance(value, list):
            if not declared.directional:
                unit = in_unit(axis_unit(declared.unit, self.sheet))
                raise self.fail(key, f"must be one number{unit}, got {short_repr(value)}")
            if len(value) != 2:
                raise self.fail(key, f"needs two values, [positive, negative], got {short_repr(value)}")
            return Directional(*(self._number(key, side, declared.unit) for side in value))
        return self._number(key, value, declared.unit)

    def build(self, cls: type[Parameters], **values: object) -> Parameters:
        """An instance of a parameter class from the keys of this section, beside `values`."""
        for field in dataclasses.fields(cls):
            if "quantity" in field.metadata and field.name not in values:
                values[field.name] = self.quantity(field.name, field.metadata["quantity"], field.default)
        try:
            built = cls(**values)
            check(built, self.name)
        except ParameterError as error:
            raise DriveFileError(f"{self.source}: {error}") from None
        return built

    def done(self) -> None:
        """Raise if keys are left that were never taken, here or in a subsection."""
        for subsection in self._below:
            subsection.done()
        if not self._remaining:
            return
        key = next(iter(self._remaining))
        if kinds := self.kinds_with(key):
            foreign = [other for other in self._remaining if self.kinds_with(other)]
            raise self.fail(
                key, f"belongs to kind {', '.join(kinds)}; for kind {self.kind} remove {', '.join(foreign)}"
            )
        close = difflib.get_close_matches(key, self._accepted, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known here: {', '.join(sorted(set(self._accepted)))}"
        raise self.fail(key, f"unknown key; {hint}")


def _data_sheet(section: TomlSection) -> DataSheet:
    """The table [axis]. Its numbers are the motor's own; the scale is at the table, and counts rad where that turns."""
    kind = section.take("kind", "linear")
    if kind not in AXIS_KINDS:
        raise section.fail("kind", f"must be one of {', '.join(AXIS_KINDS)}, got {short_repr(kind)}")
    at_table = TomlSection(section.source, section.name, section.table, DataSheet(kind=kind))
    name = "scale_period"
    section.take(name, None)
    period = at_table.quantity(name, DataSheet.__dataclass_fields__[name].metadata["quantity"], None)
    return section.build(DataSheet, kind=kind, scale_period=period)


def _lighter_than_rotor(plant: Plant, sheet: DataSheet) -> str:
    return (
        f"is {float(plant.mass):.4g} {axis_unit('kg', sheet)}, less than the motor's rotor alone: [axis] motor_inertia "
        f"makes {sheet.rotor_mass:.4g}; check its unit, lead and gear_ratio"
    )


def _limits(section: TomlSection) -> Limits:
    stroke = section.take("stroke", None)
    if stroke is None:
        ends = (-np.inf, np.inf)
    else:
        if not isinstance(stroke, list) or len(stroke) != 2:
            raise section.fail("stroke", f"must be [lowest, highest], such as [0.0, 0.15], got {short_repr(stroke)}")
        plain = [end for end in stroke if not isinstance(end, str)]
        if len(plain) == 1 and plain[0] != 0:  # 75 beside "-75 mm" would be 75 m
            raise section.fail(
                "stroke", f"give both ends a unit, or neither where they are in m, got {short_repr(stroke)}"
            )
        ends = (section._number("stroke", stroke[0], "m"), section._number("stroke", stroke[1], "m"))
        if not ends[0] < ends[1]:
            raise section.fail("stroke", f"the lowest position must be below the highest, got {short_repr(stroke)}")
    limits = {key: section.number(key, unit, np.inf) for key, unit in (("speed", "m/s"), ("acceleration", "m/s^2"))}
    for key, value in limits.items():
        if not value > 0:
            raise section.fail(key, f"must be positive, got {short_repr(value)}")
    return Limits(stroke=ends, **limits)


def _trace(section: TomlSection, rate: float, drive: Drive) -> Trace:
    """The table [trace] of a control at `rate` (Hz)."""
    words = {name: section.take(name, known[0]) for name, known in CHOICES.items()}
    traced = section.number("rate", "Hz", rate) if "rate" in section.table else None
    trace = section.build(Trace, rate=traced, **words)
    try:
        check_trace(trace, rate, has_motor_encoder=drive.motor_encoder is not None)
    except ParameterError as error:
        raise DriveFileError(f"{section.source}: {error}") from None
    return trace


def _trace_table(trace: Trace) -> TomlTable:
    """The keys of [trace] that are not at their defaults."""
    words = {name: getattr(trace, name) for name, known in CHOICES.items() if getattr(trace, name) != known[0]}
    return ({} if trace.rate is None else {"rate": float(trace.rate)}) | words | quantity_table(trace)


def _effects(section: TomlSection) -> tuple[Effect, ...]:
    """The effects of the tables [effects.NAME], in the catalogue's order; what [axis] states may be left out."""
    effects = []
    for name, effect in EFFECTS.items():
        if section.take(name, None) is not None:
            subsection = TomlSection(section.source, f"effects.{name}", section.table[name], section.sheet)
            stated = stated_parameters(section.sheet, effect)
            left_out = {key: value for key, value in stated.items() if key not in subsection.table}
            effects.append(subsection.build(effect, **left_out))
            subsection.done()
    section.done()
    try:
        require_agreement(effects, section.sheet)
    except ParameterError as error:
        raise DriveFileError(f"{section.source}: {error}") from None
    return tuple(effects)


def parse_axis(tables: Mapping[str, object], source: str = "drive") -> Axis:
    """A drive file's tables, already read from TOML; `source` names the file in errors."""
    root = TomlSection(source, "drive file", tables)
    stated = TomlSection(source, "axis", root.take("axis", {}))
    sheet = _data_sheet(stated)
    sections = {
        name: TomlSection(source, name, root.take(name, {}), sheet)
        for name in ("plant", "friction", "actuator", "sensor", "controller", "sampling", "trace", "limits")
    }
    try:
        mapping = parse_mapping(sheet, *(cast(TomlTable, root.take(key, {})) for key in ("columns", "units", "shifts")))
    except LogError as error:
        raise DriveFileError(f"{source}: {error}") from None
    effects, motor_encoder = root.take("effects", {}), root.take("motor_encoder", None)
    root.done()
    if motor_encoder is not None:
        sections["motor_encoder"] = TomlSection(source, "motor_encoder", motor_encoder, sheet)
    delay = sections["actuator"].take("delay_samples", 0)
    if isinstance(delay, bool) or not isinstance(delay, int) or delay < 0:
        raise sections["actuator"].fail(
            "delay_samples", f"must be a whole number of samples, 0 or more, got {short_repr(delay)}"
        )
    drive = Drive(
        plant=sections["plant"].build(Plant),
        friction=sections["friction"].build(Friction),
        actuator=sections["actuator"].build(Actuator, delay_samples=delay),
        sensor=sections["sensor"].build(Sensor),
        effects=_effects(TomlSection(source, "effects", effects, sheet)),
        motor_encoder=None if motor_encoder is None else sections["motor_encoder"].build(Sensor),
    )
    if sheet.rotor_mass is not None and float(drive.plant.mass) < LIGHTEST_ROTOR * sheet.rotor_mass:
        raise sections["plant"].fail("mass", _lighter_than_rotor(drive.plant, sheet))
    rate = sections["sampling"].number("rate", "Hz", 10_000.0)
    substeps = sections["sampling"].take("substeps", None)
    try:
        check_drive(drive)
        sampling = Sampling(rate, substeps)  # type: ignore[arg-type]  # which checks them
    except ParameterError as error:
        raise DriveFileError(f"{source}: {error}") from None
    limits = _limits(sections["limits"])
    low, high = limits.stroke
    try:
        require_feasible(drive, limits_envelope(limits, sampling))
    except ParameterError as error:
        raise DriveFileError(f"{source}: {error}") from None
    for name, encoder in (("sensor", drive.sensor), ("motor_encoder", drive.motor_encoder)):
        if encoder is not None and float(encoder.resolution or 0.0) > 1e-2 * min(high - low, 1.0):
            raise sections[name].fail(
                "resolution",
                f"{encoder.resolution:g} {axis_unit('m', sheet)} is coarser than a hundredth of the stroke; is it in "
                f"{'microradians' if sheet.is_rotary else 'micrometres'}?",
            )
    controller = build_controller(sections["controller"], drive)
    try:
        require_rate(controller, sampling.rate)
    except ParameterError as error:
        raise DriveFileError(f"{source}: {error}") from None
    trace = _trace(sections["trace"], sampling.rate, drive)
    for section in (stated, *sections.values()):
        section.done()
    return Axis(drive, controller, sampling, limits, mapping, trace=trace, sheet=sheet)


def read_axis(path: str | Path) -> Axis:
    """Read a drive file (docs/reference/drive-file.md).

    Args:
        path: A TOML file; `diffdrive template > drive.toml` writes one to start from.

    Raises:
        DriveFileError: It cannot be read: names the file, the key and the remedy.

    Examples:
        >>> axis = read_axis("drive.toml")
        >>> axis.value("plant.mass")

    """
    origin = "'diffdrive template > drive.toml' writes one to start from"
    axis = parse_axis(read_toml(Path(path), DriveFileError, origin), str(path))
    return dataclasses.replace(axis, name=Path(path).stem)


def axis_tables(axis: Axis) -> dict[str, TomlTable]:
    """The tables of a drive file that `parse_axis` reads back to the same axis."""
    drive, limits = axis.drive, axis.limits
    sheet = without_contradicted(axis.sheet, drive.effects)
    tables: dict[str, TomlTable] = {} if sheet.is_empty else {"axis": {"kind": sheet.kind} | quantity_table(sheet)}
    tables |= {
        "plant": quantity_table(drive.plant),
        "friction": quantity_table(drive.friction),
        "actuator": quantity_table(drive.actuator) | {"delay_samples": drive.actuator.delay_samples},
        "sensor": quantity_table(drive.sensor),
        **({} if drive.motor_encoder is None else {"motor_encoder": quantity_table(drive.motor_encoder)}),
        "controller": controller_table(axis.controller),
        "sampling": {"rate": axis.sampling.rate},
        "limits": {},
    }
    if axis.sampling.substeps is not None:
        tables["sampling"]["substeps"] = axis.sampling.substeps
    if trace := _trace_table(axis.trace):
        tables["trace"] = trace
    if np.isfinite(limits.stroke).any():
        tables["limits"]["stroke"] = list(limits.stroke)
    for name in ("speed", "acceleration"):
        if np.isfinite(getattr(limits, name)):
            tables["limits"][name] = getattr(limits, name)
    if drive.effects:
        tables["effects"] = {effect.name: _effect_table(effect, sheet) for effect in drive.effects}
    return tables | mapping_tables(axis.mapping)


def _effect_table(effect: Effect, sheet: DataSheet) -> TomlTable:
    """What the data sheet does not state."""
    stated = stated_parameters(sheet, type(effect))
    return {key: value for key, value in quantity_table(effect).items() if stated.get(key) != value}


def faithful_tables(axis: Axis, source: str) -> dict[str, TomlTable]:
    """`axis_tables`, read back for comparison; raises `DriveFileError`, which names `source`, if no file can hold the
    axis.
    """
    tables = axis_tables(axis)
    read_back = parse_axis(tables, source)
    for name in ("drive", "controller"):
        written, reread = (jax.tree.flatten(getattr(side, name)) for side in (axis, read_back))
        same_structure = written[1] == reread[1]  # type: ignore[operator]  # jax's types leave PyTreeDef empty
        if not same_structure or [*map(float, written[0])] != [*map(float, reread[0])]:
            raise DriveFileError(
                f"{source}: this {name} cannot be written as a drive file: in a file, observers and feed-forwards take "
                "their model from [plant] and [friction]"
            )
    return tables


def write_axis(path: str | Path, axis: Axis, comments: Sequence[str] = ()) -> None:
    """Write a drive file in SI units, below lines of comments; raises `DriveFileError` if no file can hold the axis."""
    tables = faithful_tables(axis, str(path))
    write_text(path, "".join(f"# {line}\n" for line in comments) + tomli_w.dumps(tables))
