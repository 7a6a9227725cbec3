"""The table [uncertainty] of a drive file: standard deviations by the paths of parameters, and correlations.

[uncertainty]
"plant.mass" = "0.5 %"               # of its value, log-normal
"plant.constant_force" = "2 N"       # in its unit, normal
[uncertainty.correlation."plant.mass"]
"plant.constant_force" = -0.9
"""

import math
from decimal import Decimal, InvalidOperation

from diffdrive.axis_file.section import TomlSection
from diffdrive.errors import DriveFileError, ParameterError
from diffdrive.model.motor_units import axis_unit
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import Directional, node_at, quantities
from diffdrive.model.uncertainty import MAX_LOG_DEVIATION, Deviation, Uncertainty
from diffdrive.support.messages import short_repr, suggestion
from diffdrive.support.typing import TomlTable

PARTS = ("plant.", "friction.")  # of the machine, whose parameters may be uncertain
SIDES = (".positive", ".negative")


def parse_uncertainty(section: TomlSection, drive: Drive) -> Uncertainty | None:
    """What the table says of this drive; None where it is empty. Raises `DriveFileError`."""
    pairs, units = section.take("correlation", {}), _units(drive)
    names = [name for name in section.table if name != "correlation"]
    deviations = {name: _deviation(section, name, units, drive) for name in names}
    for name in names:
        if {f"{name}{side}" for side in SIDES} & set(names):
            raise section.fail(name, "stands for both directions, one of which is stated beside it: leave out either")
    below = TomlSection(section.source, f"{section.name}.correlation", pairs)
    correlation = {}
    for name in below.table:
        of = TomlSection(section.source, f'{below.name}."{name}"', below.take(name))
        correlation[name] = {other: of.number(other, "1") for other in of.table}
    if not (deviations or correlation):
        return None
    try:
        return Uncertainty.of(deviations, correlation)
    except ParameterError as problem:
        raise DriveFileError(f"{section.source}: [{section.name}] {problem}") from None


def _units(drive: Drive) -> dict[str, str]:
    """The units of what may be uncertain, by path: every parameter of plant and friction that the drive has."""
    units: dict[str, str] = {}
    for name, declared, value in quantities(drive):
        if name.startswith(PARTS) and value is not None:
            sides = SIDES if declared.directional else ()
            units |= dict.fromkeys((name, *(f"{name}{side}" for side in sides)), declared.unit)
    return units


def _deviation(section: TomlSection, name: str, units: dict[str, str], drive: Drive) -> Deviation:
    """One standard deviation, as a share of a value or in its unit."""
    given = section.take(name)
    if isinstance(given, dict):
        raise section.fail(name, f'put quotation marks about the whole path of a parameter: "{name}.NAME" = ...')
    if name not in units:
        raise section.fail(name, f"is no parameter of [plant] or [friction]; {suggestion(name, units)}")
    unit, is_relative = units[name], isinstance(given, str) and given.strip().endswith("%")
    value = _share(section, name, str(given)) if is_relative else section.number_from(name, given, unit)
    if not 0.0 < value < math.inf:
        raise section.fail(name, f"must be above zero and finite, got {short_repr(given)}; leave out what is known")
    if is_relative and value > MAX_LOG_DEVIATION:
        raise section.fail(name, f'{given} of a value is too wide; write for example "3 %"')
    if is_relative and not min(_values(drive, name)) > 0.0:
        unit = axis_unit(unit, section.sheet)
        raise section.fail(name, f"is relative to a value that is not above zero; state it in {unit}")
    return Deviation(value, is_relative)


def _share(section: TomlSection, name: str, text: str) -> float:
    """A share from per cent, by a shift of the decimal point: a division would not give back every number written."""
    try:
        return float(Decimal(text.strip().removesuffix("%")).scaleb(-2))
    except InvalidOperation:
        raise section.fail(name, f'cannot read {short_repr(text)}; write for example "3 %"') from None


def _values(drive: Drive, name: str) -> tuple[float, ...]:
    value = node_at(drive, name)
    return (float(value.positive), float(value.negative)) if isinstance(value, Directional) else (float(value),)


def uncertainty_table(uncertainty: Uncertainty | None) -> TomlTable:
    """The table, which reads back to the last bit; empty for none."""
    if uncertainty is None:
        return {}
    stated = zip(uncertainty.names, uncertainty.deviations, strict=True)
    table: TomlTable = {name: _percent(one.value) if one.is_relative else float(one.value) for name, one in stated}
    correlations = uncertainty.correlations
    return table | ({"correlation": correlations} if correlations else {})


def _percent(share: float) -> str:
    return f"{Decimal(repr(float(share))).scaleb(2)} %"
