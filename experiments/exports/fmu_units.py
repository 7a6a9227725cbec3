"""The units of an FMU: each by the base units of FMI 3.0, so that a tool can check what is connected."""

from typing import TYPE_CHECKING

from experiments.exports.program import Program

if TYPE_CHECKING:
    import pint

BASES = {
    "kilogram": "kg", "meter": "m", "second": "s", "ampere": "A", "kelvin": "K", "mole": "mol", "candela": "cd",
    "radian": "rad",
}  # fmt: skip
LOGARITHMIC = {"dB"}


def units_of(program: Program) -> dict[str, dict[str, str] | None]:
    """The attributes of each unit's `BaseUnit`; None for one that no product of base units is, such as dB."""
    signals = (*program.inputs, *(signal for signal, _ in program.outputs))
    names = ["s", *(one.unit for one in signals), *(one.unit for one in program.parameters)]
    import pint  # half a second, and no other export reads units

    registry = pint.UnitRegistry(autoconvert_offset_to_baseunit=True)
    return {name: _base_unit(registry, name) for name in dict.fromkeys(names)}


def _base_unit(registry: "pint.UnitRegistry", name: str) -> dict[str, str] | None:
    """Powers of the base units, and factor and offset where they are not one and zero."""
    import pint

    try:
        zero, one = (registry.Quantity(number, name).to_base_units() for number in (0.0, 1.0))
    except (pint.UndefinedUnitError, pint.DefinitionSyntaxError):
        return None
    units = {unit: float(f"{power}") for unit, power in one.unit_items()}
    if name in LOGARITHMIC or not set(units) <= set(BASES) or not all(power.is_integer() for power in units.values()):
        return None
    offset = float(zero.magnitude)
    factor = float(one.magnitude) - offset
    powers = {BASES[unit]: str(round(power)) for unit, power in units.items()}
    scale = {} if factor == 1.0 else {"factor": repr(factor)}
    return powers | scale | ({} if offset == 0.0 else {"offset": repr(offset)})
