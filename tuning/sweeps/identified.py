"""What is not known of a machine, as what a sweep varies: an axis's uncertainty, and the file uncertainty.toml."""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, cast

import tomli_w

from diffdrive.axis import Axis
from diffdrive.errors import ParameterError
from diffdrive.model.motor_units import axis_unit
from diffdrive.model.uncertainty import Uncertainty
from diffdrive.numerics.correlation import Correlation
from diffdrive.support.atomic_write import write_text
from diffdrive.support.text_file import read_toml
from tuning.sweeps.varied import known_quantities

FILE = "uncertainty.toml"


class Distributions(NamedTuple):
    """Distributions by the name of a quantity, as `varied.parse_varied` takes them, and correlations of pairs."""

    vary: Mapping[str, str]
    correlation: Correlation


def about_nominal(uncertainty: Uncertainty) -> Distributions:
    """What is uncertain, about the values of the drive that varies."""
    return _distributions(uncertainty, dict.fromkeys(uncertainty.names, ""), dict.fromkeys(uncertainty.names, ""))


def about_identified(axis: Axis) -> Distributions:
    """What is uncertain of an identified axis about its own values, whatever the drive that varies."""
    if axis.uncertainty is None:
        return Distributions({}, {})
    known = known_quantities(axis.drive, axis.sheet)
    units = {name: axis_unit(known[name].unit, axis.sheet) for name in axis.uncertainty.names}
    units = {name: "" if unit == "1" else f" {unit}" for name, unit in units.items()}
    middles = {name: f"{known[name].values[0]!r}{unit}.." for name, unit in units.items()}
    return _distributions(axis.uncertainty, middles, units)


def _distributions(uncertainty: Uncertainty, middles: Mapping[str, str], units: Mapping[str, str]) -> Distributions:
    """With all digits, so that the same machines are drawn of a result, of its files and of its axis."""
    stated = zip(uncertainty.names, uncertainty.deviations, strict=True)
    texts = {
        name: f"lognormal:{middles[name]}{value!r}" if is_relative else f"normal:{middles[name]}{value!r}{units[name]}"
        for name, (value, is_relative) in stated
    }
    return Distributions(texts, uncertainty.correlations)


def write_uncertainty(folder: Path, identified: Axis) -> None:
    """As a file."""
    write_text(folder / FILE, tomli_w.dumps(about_identified(identified)._asdict()))


def read_uncertainty(path: Path) -> Distributions:
    """What an identification left open: its file uncertainty.toml."""
    tables = read_toml(path, ParameterError, "`diffdrive identify --out FOLDER` writes it")
    if "vary" not in tables:
        raise ParameterError(f"{path}: is no uncertainty.toml of an identification: it has no table [vary]")
    try:
        correlations = cast(Correlation, tables.get("correlation", {}))
        return Distributions(
            {name: str(text) for name, text in cast(Mapping[str, str], tables["vary"]).items()},
            {quantity: {other: float(value) for other, value in of.items()} for quantity, of in correlations.items()},
        )
    except (AttributeError, TypeError, ValueError, OverflowError) as problem:
        raise ParameterError(f"{path}: is no uncertainty.toml of an identification: {problem}") from None
