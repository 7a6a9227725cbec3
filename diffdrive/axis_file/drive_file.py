"""Drive files: the nominal axis, as TOML in SI units or with units spelled out.

    [plant]       mass = 100.0              or  mass = "100 kg"
                  damping = [380.0, 260.0]      one value per direction: [positive, negative]

Tables and keys are those of the parameter classes; `diffdrive template` prints a complete file. Anything unknown is an
error, because a misspelt key that is silently ignored is a wrong simulation.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import cast

import jax
import numpy as np
import tomli_w

from diffdrive.axis import Axis
from diffdrive.axis_file.controller_file import build_controller, controller_table
from diffdrive.axis_file.section import TomlSection
from diffdrive.axis_file.uncertainty_table import parse_uncertainty, uncertainty_table
from diffdrive.controllers.base import require_rate
from diffdrive.effects.base import Effect
from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.data_sheet import require_agreement, stated_parameters, without_contradicted
from diffdrive.effects.feasibility import limits_envelope, require_feasible
from diffdrive.errors import DriveFileError, LogError, ParameterError
from diffdrive.library.provenance import Provenance
from diffdrive.library.search import drive_path
from diffdrive.logs.mapping import mapping_tables, parse_mapping
from diffdrive.model.data_sheet import KINDS as AXIS_KINDS
from diffdrive.model.data_sheet import DataSheet
from diffdrive.model.motor_units import axis_unit
from diffdrive.model.parameters import Actuator, Drive, Friction, Plant, Sampling, Sensor, check_drive
from diffdrive.model.quantity import quantity_table
from diffdrive.model.trace import CHOICES, Trace, check_trace
from diffdrive.motion.motion import Limits
from diffdrive.support.atomic_write import write_text
from diffdrive.support.messages import short_repr
from diffdrive.support.text_file import read_toml
from diffdrive.support.typing import TomlTable

LIGHTEST_ROTOR = 0.9  # of its inertia on the data sheet, which is stated to 10 %


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
        ends = (section.number_from("stroke", stroke[0], "m"), section.number_from("stroke", stroke[1], "m"))
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
    Provenance.of(
        root.take("provenance", {}), source
    )  # about this file: what a program makes of the axis is not from there
    stated = TomlSection(source, "axis", root.take("axis", {}))
    sheet = _data_sheet(stated)
    sections = {
        name: TomlSection(source, name, root.take(name, {}), sheet)
        for name in (
            "plant",
            "friction",
            "actuator",
            "sensor",
            "controller",
            "sampling",
            "trace",
            "limits",
            "uncertainty",
        )
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
    uncertainty = parse_uncertainty(sections["uncertainty"], drive)
    for section in (stated, *sections.values()):
        section.done()
    return Axis(drive, controller, sampling, limits, mapping, trace=trace, sheet=sheet, uncertainty=uncertainty)


def read_axis(path: str | Path) -> Axis:
    """Read a drive file (docs/reference/drive-file.md), or an axis of the library (docs/reference/axes.md).

    Args:
        path: A TOML file; `diffdrive template > drive.toml` writes one to start from. Or the name of an axis of the
            library, such as `gantry`, where no file has it; `axes` says which there are.

    Raises:
        DriveFileError: It cannot be read: names the file, the key and the remedy. Or there is no such axis.

    Examples:
        >>> axis = read_axis("drive.toml")
        >>> axis.value("plant.mass")
        >>> read_axis("gantry")
        Axis(600 kg, cascade, 2000 Hz)

    """
    file = drive_path(path)
    origin = "'diffdrive template > drive.toml' writes one to start from"
    axis = parse_axis(read_toml(file, DriveFileError, origin), str(file))
    return dataclasses.replace(axis, name=file.stem)


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
    if uncertainty := uncertainty_table(axis.uncertainty):
        tables["uncertainty"] = uncertainty
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
