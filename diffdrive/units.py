"""Numbers with units as people write them, in SI."""

import functools
import re

import pint

_NUMBER_AND_UNIT = re.compile(r"\s*[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?\s*(?P<unit>|(?!.*\s\d)[^\d\s.,*+-][^,]*)")


@functools.cache
def _registry() -> pint.UnitRegistry:
    return pint.UnitRegistry()


def to_si(text: str, unit: str) -> float:
    """`text`, one number and its unit, in the SI `unit`; without a unit only where `unit` is 1.

    Raises `ValueError` saying what is wrong with the text. Angles count as units of their own: to the library a radian
    is a plain number, so that 1500 rad/s would pass for 1500 Hz and 10 deg for 0.17 m.
    """
    example = "0.5, without a unit" if unit == "1" else f"'1.5 {unit}'"
    if not _NUMBER_AND_UNIT.fullmatch(text):
        raise ValueError(f"cannot read '{text}' as one number and its unit; write for example {example}")
    try:
        quantity = _registry().Quantity(text)
        angular = "radian" in str(quantity.to_base_units().units) or "degree" in str(quantity.units)
        if angular and unit != "rad":
            raise pint.DimensionalityError(text, unit)
        return float(quantity.to("dimensionless" if unit == "1" else unit).magnitude)
    except pint.DimensionalityError:
        wanted = "a plain number" if unit == "1" else f"in {unit} or a multiple of it"
        raise ValueError(f"'{text}' has the wrong unit: it must be {wanted}") from None
    except Exception:
        raise ValueError(f"cannot read '{text}' as a number with a unit; write for example {example}") from None
