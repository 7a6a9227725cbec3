"""Numbers in the shop's units as numbers in the axis's own: N, m and kg at the table.

A motor's angle is a travel of the table, its torque a force, its inertia a mass, by the table's travel per radian r:

    position = r angle ,   force = torque / r ,   mass = inertia / r^2

and what is made of these (gains, dampings, variances) by the powers of N, m and kg in its unit. A current is a torque
by the torque constant, a per cent is one of the rated torque, a count of the motor's encoder an angle. On a rotary axis
N m, rad and kg m^2 are the table's own, and so are deg, rev and rpm.
"""

import itertools
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

from diffdrive.model.data_sheet import DataSheet
from diffdrive.support.messages import shortened
from diffdrive.support.units import WrongUnitError, to_si

_FACTOR = re.compile(r"(?P<sign>^|[*/])(?P<name>[^*/^]+)(?:\^(?P<power>\d+))?")
_SPEED = {"m": 1, "s": -1}
# how data sheets write turns per minute; a 1 between the number and the stroke is part of the unit
_PER_MINUTE = re.compile(
    r"(?P<turns>\s*[-+]?[\d.]+([eE][-+]?\d+)?)\s*(((?<=\s)1|U|r|rev)?\s*/\s*min|min\s*(\^|\*\*)?\s*-\s*1|min⁻¹)\s*"
)
_OF_ROTARY = {"N": "N*m", "m": "rad", "kg": "kg*m^2"}  # in the place of a linear axis's
_MIXED = ({"N", "rad"}, {"N*m", "m"})  # of table and motor: nobody states a gain so, and N*m/m would pass for N


class MissingKeysError(ValueError):
    """A unit of the motor that the data sheet says too little to read: `keys` of [axis] are missing."""

    def __init__(self, keys: Sequence[str], text: str) -> None:
        self.keys = "[axis] " + " and ".join(keys)
        super().__init__(f"{self.keys} {'is' if len(keys) == 1 else 'are'} needed to read '{shortened(text)}'")


class _Stated(NamedTuple):
    """A unit in the place of another, what one of it is worth, and the keys of [axis] that do not say it yet."""

    unit: str
    worth: float = 1.0
    missing: tuple[str, ...] = ()


def to_axis_si(text: str, unit: str, sheet: DataSheet) -> float:
    """`text`, one number and its unit, in the SI `unit` of a parameter, by the axis's data sheet where it needs one.

    `unit` is a linear axis's, such as N*s/m; a rotary one has the same parameter in N*m*s/rad. Raises `ValueError` with
    the reason: `WrongUnitError` for a unit of something else, `MissingKeysError` for keys of [axis] that it takes.
    """
    powers = _powers(unit)
    turns = _PER_MINUTE.fullmatch(text) if powers == _SPEED else None
    number = text if turns is None else f"{turns['turns']} rpm"
    refused: WrongUnitError | None = None
    for stated in _ways_to_state(powers, sheet):
        try:
            value = to_si(number, _in_units(powers, stated))
        except WrongUnitError as problem:
            refused = refused or problem  # that of the axis's own unit is the one to tell
            continue
        missing = list(dict.fromkeys(key for one in stated.values() for key in one.missing))
        if missing:
            raise MissingKeysError(missing, text)
        return value * math.prod(one.worth ** powers[name] for name, one in stated.items())
    assert refused is not None
    raise refused


def axis_unit(unit: str, sheet: DataSheet) -> str:
    """The SI unit that a parameter of this axis has; `unit` is a linear axis's."""
    if not sheet.is_rotary:
        return unit
    return _in_units(_powers(unit), {name: _Stated(other) for name, other in _OF_ROTARY.items()})


def _powers(unit: str) -> dict[str, int]:
    """The units in it with their powers; a unit that is no product of such is one of its own."""
    powers = {}
    for factor in _FACTOR.finditer(unit):
        powers[factor["name"]] = int(factor["power"] or 1) * (-1 if factor["sign"] == "/" else 1)
    return powers


def _in_units(powers: Mapping[str, int], stated: Mapping[str, _Stated]) -> str:
    """The unit with others in the place of some."""
    text = ""
    for name, power in powers.items():
        unit = stated[name].unit if name in stated else name
        unit = f"({unit})" if unit != name and (power != 1 or text) and "*" in unit else unit
        text += f"{'/' if power < 0 else '*' if text else ''}{unit}" + (f"^{abs(power)}" if abs(power) != 1 else "")
    return f"1{text}" if text.startswith("/") else text


def _ways_to_state(powers: Mapping[str, int], sheet: DataSheet) -> Iterator[dict[str, _Stated]]:
    """Every set of units that may stand in the place of N, m, kg and A; the axis's own first."""
    if powers == {"A": 1}:
        yield {}
        current = sheet.rated_current
        yield {"A": _Stated("percent", 0.01 * (current or 1.0), () if current else ("rated_current",))}
        return
    of = {"N": _forces(sheet), "m": _lengths(sheet), "kg": _masses(sheet)}
    names = [name for name in of if name in powers]
    for choice in itertools.product(*(of[name] for name in names)):
        stated = dict(zip(names, choice, strict=True))
        if {one.unit for one in choice} not in _MIXED:
            yield stated


def _travel(sheet: DataSheet) -> tuple[float, tuple[str, ...]]:
    """The table's travel per radian of the motor, and the keys that do not say it yet."""
    travel = sheet.travel_per_radian
    return (1.0, ("lead",)) if travel is None else (travel, ())


def _forces(sheet: DataSheet) -> list[_Stated]:
    travel, missing = _travel(sheet)

    def by_torque(unit: str, torque: float | None, key: str) -> _Stated:
        return _Stated(unit, (torque or 1.0) / travel, missing if torque else (key, *missing))

    rated = None if sheet.rated_torque is None else 0.01 * sheet.rated_torque
    of_motor = [
        by_torque("A", sheet.torque_per_ampere, "torque_constant"),
        by_torque("percent", rated, "rated_torque"),
    ]
    if sheet.is_rotary:
        return [_Stated(_OF_ROTARY["N"]), *of_motor]
    return [_Stated("N"), _Stated("N*m", 1.0 / travel, missing), *of_motor]


def _lengths(sheet: DataSheet) -> list[_Stated]:
    travel, missing = _travel(sheet)
    counts = sheet.encoder_counts
    count = _Stated(
        "count", 2.0 * math.pi * travel / (counts or 1.0), missing if counts else ("encoder_counts", *missing)
    )
    return (
        [_Stated(_OF_ROTARY["m"]), count] if sheet.is_rotary else [_Stated("m"), _Stated("rad", travel, missing), count]
    )


def _masses(sheet: DataSheet) -> list[_Stated]:
    travel, missing = _travel(sheet)
    return [_Stated(_OF_ROTARY["kg"])] if sheet.is_rotary else [_Stated("kg"), _Stated("kg*m^2", travel**-2, missing)]
