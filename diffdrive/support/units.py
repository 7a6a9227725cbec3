"""Conversion of text with a unit to SI."""

import functools
import math
import re
from typing import TYPE_CHECKING, Any

from diffdrive.support.messages import shortened

if TYPE_CHECKING:
    import pint

# pint alone reads "kg" as 1 kg, "100,5 kg" as 1005 kg and "100 200 kg" as 20000 kg
_NUMBER_AND_UNIT = re.compile(
    r"\s*(?P<number>[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?)\s*(?P<unit>|(1(?=/))?(?!.*\s\d)[^\d\s.,*+-][^,]*)"
)
# an M for an m; nobody writes a million of these so
_SLIPS = {"megameter": ("Mm", "mm", "1000 km"), "megasecond": ("Ms", "ms", "1e6 s"), "megagram": ("Mg", "mg", "1 t")}


@functools.cache
def _registry() -> "pint.UnitRegistry":
    import pint  # half a second, and most programs read no unit

    registry = pint.UnitRegistry()
    registry.define("newton_meter = newton * meter = Nm")  # as data sheets write them, and pint does not
    registry.define("@alias turn = rev")
    return registry


class WrongUnitError(ValueError):
    """A number with a unit, but not with one that converts to the unit asked for."""


def in_unit(unit: str) -> str:
    """The phrase " in UNIT" for a message; empty for a ratio."""
    return "" if unit == "1" else f" in {unit}"


def to_si(text: str, unit: str) -> float:
    """`text`, one number and its unit, in the SI `unit`; without a unit only where `unit` is 1.

    Raises `ValueError` with the reason, `WrongUnitError` where only the unit is another. A million metres, seconds or
    grams (Mm for mm) are taken for a typing error. Angles and counts are units of their own, and a percent is one but
    where a ratio is asked for: pint treats them as plain numbers, so that 1500 rad/s would pass for 1500 Hz, 10 deg for
    0.17 m and 80 % for 0.8 counts.
    """
    import pint

    example = "0.5, without a unit" if unit == "1" else f"'1.5 {unit}'"
    quoted, units = shortened(text), []
    split = _NUMBER_AND_UNIT.fullmatch(text)
    if split is None:
        raise ValueError(f"cannot read '{quoted}' as one number and its unit; write for example {example}")
    try:
        # apart: pint before 0.26 multiplies a number by decibels in an expression only where a registry allows it
        per = "1" if split["unit"].startswith("/") else ""
        quantity = _registry().Quantity(float(split["number"]), per + split["unit"])
        units = [name for name, _ in quantity.unit_items()]
        given, wanted = _plain_to_pint(quantity), _plain_to_pint(_registry().Quantity(1.0, _pint_unit(unit)))
        if unit == "1":
            given = {name: power for name, power in given.items() if name == "radian"}
        if given != wanted:
            raise pint.DimensionalityError(text, unit)
        value = float(quantity.to(_pint_unit(unit)).magnitude)
    except pint.DimensionalityError:
        expected = "a plain number" if unit == "1" else f"in {unit} or a multiple of it"
        raise WrongUnitError(f"'{quoted}' has the wrong unit: it must be {expected}") from None
    except OverflowError:  # a whole number of 400 digits
        value = math.inf
    except Exception:
        raise ValueError(f"cannot read '{quoted}' as a number with a unit; write for example {example}") from None
    for slip, (symbol, intended, meaning) in _SLIPS.items():
        if slip in units:
            raise ValueError(f"'{quoted}' says {symbol}, which is {meaning}; write {intended} if that is meant")
    if not math.isfinite(value):
        raise ValueError(f"'{quoted}' is larger than any number of double precision")
    return value


def _pint_unit(unit: str) -> str:
    return "dimensionless" if unit == "1" else unit


def _plain_to_pint(quantity: "pint.Quantity") -> dict[str, float]:
    """The powers of the units in it that pint treats as plain numbers, though they are none."""
    base: dict[str, Any] = dict(quantity.to_base_units().unit_items())
    stated: dict[str, Any] = dict(quantity.unit_items())
    share = stated.get("percent", 0) + stated.get("permille", 0)
    powers = {"radian": base.get("radian", 0), "count": base.get("count", 0), "percent": share}
    return {name: power for name, power in powers.items() if power}
