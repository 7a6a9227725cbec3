"""Units of a log's columns: what one unit of a column is in SI, and where a header says so."""

import re
from typing import NamedTuple

import numpy as np

from diffdrive.logs.log import READABLE
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.motor_units import MissingKeysError, axis_unit, to_axis_si
from diffdrive.support.units import to_si

FORCE_PER = {"force_per_volt": "V", "force_per_ampere": "A"}
FORCES = ("command", "disturbance", "injected")  # what a drive may log in volts or amperes

_SCALES_OF_TEMPERATURE = {
    "degc": (1.0, 0.0), "°c": (1.0, 0.0), "celsius": (1.0, 0.0), "c": (1.0, 0.0), "k": (1.0, -273.15),
    "kelvin": (1.0, -273.15), "degf": (5 / 9, -160 / 9), "°f": (5 / 9, -160 / 9), "f": (5 / 9, -160 / 9),
}  # fmt: skip
_BRACKETS = re.compile(r"(?P<name>.*\S)\s*\[(?P<unit>[^\[\]]*)\]")
_PARENTHESES = re.compile(r"(?P<name>.*\S)\s*\((?P<unit>[^()]*[^\W\d_][^()]*)\)")
# a closed list: 'position_in' is no inch, 'position_act' no attocarat
_SUFFIX = re.compile(
    r"(?P<name>.+)_(?P<unit>s|ms|us|µs|ns|m|mm|um|µm|nm|N|kN|V|mV|A|mA|degC|K|deg|mdeg|rad|mrad|rev|rpm|Nm|mNm)"
)
_ADDRESS = re.compile(r"u\d+[\s,;]+\d+")  # of an axis, as SINUMERIK writes it behind a signal's name: [u1, 1]
_NO_UNIT = ("", "-", "1", "none")
_OF_TORQUE = (
    ' (a torque of 1 N m makes 2 pi / lead newtons, lead in m: "628.3 N" at 10 mm; with [axis] lead, "N*m" is read)'
)
_EXAMPLES = {"time": "ms", "temperature": "degC"}  # of units, where counts are none


class MissingSheetError(ValueError):
    """A unit of the motor, and no data sheet that says what it is."""


class Conversion(NamedTuple):
    """A column in SI is `factor` times the column plus `offset`."""

    factor: float
    offset: float = 0.0

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """The column in SI; untouched where it is in SI already."""
        return values if self == (1.0, 0.0) else self.factor * values + self.offset


def conversion(channel: str, text: str, force_per: dict[str, float], sheet: DataSheet = NO_SHEET) -> Conversion:
    """How a column in the unit `text` becomes the SI unit of `channel`; `force_per` holds N per "V" and per "A".

    `text` is a unit (mm, V), one with a factor (50 nm, -0.1 N) or only a sign (-V). Units of the motor (%, A, deg, rpm)
    are read by the axis's data sheet; for amperes `force_per` comes first. Raises `ValueError`, with a remedy.
    """
    unit = READABLE[channel].unit
    if unit == "degC":
        if text.strip().casefold() not in _SCALES_OF_TEMPERATURE:
            raise ValueError(f"cannot read '{text}' as a unit of temperature; write degC, K or degF")
        return Conversion(*_SCALES_OF_TEMPERATURE[text.strip().casefold()])
    number = re.sub(r"^\s*([-+]?)\s*(?=[^\d\s.+-])", r"\g<1>1 ", text)
    factor = _electric_force(number, text, channel, force_per, sheet) if channel in FORCES else None
    if factor is None:
        factor = _own_unit(number, text, channel, sheet)
    if not factor:
        raise ValueError(f"'{text}' is zero; write what one unit of the column is, such as '50 nm'")
    return Conversion(factor)


def _electric_force(
    number: str, text: str, channel: str, force_per: dict[str, float], sheet: DataSheet
) -> float | None:
    """N per unit of a column in V or A; None where it is in neither, or in A and the data sheet says what that is."""
    for key, source in FORCE_PER.items():
        try:
            factor = to_si(number, source)
        except ValueError:
            continue
        if source in force_per:
            return factor * force_per[source]
        if source == "A" and sheet.torque_per_ampere is not None:
            return None
        or_sheet = ", or torque_constant in [axis]" if source == "A" else ""
        raise ValueError(
            f"a {channel} in {text.strip()} needs {key} in [units], such as {key} = 35.2 (N/{source}){or_sheet}"
        )
    return None


def _own_unit(number: str, text: str, channel: str, sheet: DataSheet) -> float:
    """SI units per unit of a column in a unit of the channel, at the table or of the motor."""
    unit = READABLE[channel].unit
    own = axis_unit(unit, sheet)
    remedy = (
        f"write one that converts to {own}, or what one unit of the column is, such as {unit_example(channel, sheet)}"
    )
    try:
        return to_axis_si(number, unit, sheet)
    except MissingKeysError as problem:
        raise MissingSheetError(f"'{text}' is no unit of the {channel} without {problem.keys}: {remedy}") from None
    except ValueError:
        raise ValueError(f"'{text}' is no unit of the {channel}: {remedy}") from None


def unit_example(channel: str, sheet: DataSheet = NO_SHEET) -> str:
    """What to write where one unit of a column is no unit of its channel, in quotes as a drive file has it."""
    example = _EXAMPLES.get(channel, f"0.05 {axis_unit(READABLE[channel].unit, sheet)}")
    return f'"{example}"{_OF_TORQUE if channel in FORCES and not sheet.is_rotary else ""}'


def is_unit_of(channel: str, text: str, sheet: DataSheet = NO_SHEET) -> bool:
    """Whether `text` is a unit of `channel`; those of a motor are where there is a data sheet, complete or not."""
    try:
        conversion(channel, text, {"V": 1.0, "A": 1.0}, sheet)
    except MissingSheetError:
        return not sheet.is_empty
    except ValueError:
        return False
    return True


def split_unit(header: str, channel: str, sheet: DataSheet = NO_SHEET) -> tuple[str, str | None]:
    """Name and unit of a header such as 'position [mm]', 'position (mm)' or 'position_mm'; None without a unit.

    Brackets always hold a unit; parentheses and suffixes may be part of a name, and count where they fit the channel.
    """
    if found := _BRACKETS.fullmatch(header.strip()):
        unit = found["unit"].strip()
        if _ADDRESS.fullmatch(unit):
            return header.strip(), None
        return found["name"], None if unit.casefold() in _NO_UNIT else unit
    for pattern in (_PARENTHESES, _SUFFIX):
        found = pattern.fullmatch(header.strip())
        if found and is_unit_of(channel, found["unit"], sheet):
            return found["name"], found["unit"].strip()
    return header.strip(), None
