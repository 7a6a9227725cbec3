"""Motions and loads as one line of text: `triangular:speed=10mm/s,stroke=20mm,rounding=0.3s,duration=4.5s`."""

import contextlib
import inspect
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from diffdrive import motion
from diffdrive.errors import MotionError, ParameterError
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.motor_units import to_axis_si
from diffdrive.motion import load
from diffdrive.motion.file import parse_motion_table, read_motion
from diffdrive.motion.motion import Motion
from diffdrive.support.messages import shortened

MOTIONS: dict[str, Callable[..., Motion]] = {
    "triangular": motion.triangular,
    "constant_speed": motion.constant_speed,
    "trapezoidal": motion.trapezoidal,
    "jerk_limited": motion.jerk_limited,
    "sine": motion.sine,
    "multisine": motion.multisine,
    "chirp": motion.chirp,
    "staircase": motion.staircase,
}
LOADS: dict[str, Callable[..., np.ndarray]] = {
    "constant": load.constant,
    "step": load.step,
    "ramp": load.ramp,
    "piecewise": load.piecewise,
    "material_removal": load.material_removal,
}
MOTION_UNITS = {
    "speed": "m/s", "speeds": "m/s", "stroke": "m", "distance": "m", "travel": "m", "amplitude": "m", "amplitudes": "m",
    "start": "m", "acceleration": "m/s^2", "jerk": "m/s^3", "rounding": "s", "ramp": "s", "duration": "s",
    "first_reversal": "s",
    "dwell": "s", "frequency": "Hz", "frequencies": "Hz", "from_frequency": "Hz", "to_frequency": "Hz", "phases": "rad",
    "load": "N", "loads": "N", "to": "N", "before": "N", "at": "s", "times": "s", "workpiece": "kg",
    "removal_rate": "kg/s", "cuts": "s", "repeats": "1",
}  # fmt: skip
LOAD_UNITS = MOTION_UNITS | {"start": "s", "end": "s"}
LISTS = ("speeds", "amplitudes", "frequencies", "phases", "times", "loads")
PAIRS = ("cuts",)


def _plain_number(text: str) -> float | None:
    """A number without a unit; None if the text is no such number."""
    with contextlib.suppress(ValueError):
        return float(text)
    return None


def number(text: str, unit: str, where: str, sheet: DataSheet = NO_SHEET) -> float:
    """A number in the SI `unit` from text: bare, or with a unit that converts to it, by the axis's data sheet."""
    plain = _plain_number(text)
    if plain is not None and math.isfinite(plain):
        return plain
    if plain is not None and any(character.isdigit() for character in text):  # and not "inf"
        raise MotionError(f"{where}: '{shortened(text)}' is larger than any number of double precision")
    try:
        return to_axis_si(text, unit, sheet)
    except ValueError as problem:
        raise MotionError(f"{where}: {problem}") from None


def nonnegative_number(text: str, unit: str, where: str, sheet: DataSheet = NO_SHEET) -> float:
    """`number`, not negative."""
    value = number(text, unit, where, sheet)
    if value < 0.0:
        raise MotionError(f"{where} {text}: must be 0 or more")
    return value


def share(value: str | float, where: str, *, at_most: float, may_be_zero: bool = False) -> float:
    """A share from `3%` or 0.03, as text or as a number: above 0, or 0 where it may be, and up to `at_most`."""
    text = str(value).strip()
    found = _plain_number(text.removesuffix("%"))
    found = math.nan if found is None else found / (100.0 if text.endswith("%") else 1.0)
    if not (found > 0.0 or (may_be_zero and found == 0.0)) or found > at_most:
        bounds = f"{'from 0 to' if may_be_zero else 'above 0 and up to'} {at_most:.0%}"
        raise ParameterError(f"{where} {shortened(text)}: give a share {bounds}, as 3% or 0.03")
    return found


def numbers(text: str, unit: str, where: str, sheet: DataSheet = NO_SHEET) -> list[float]:
    """Numbers separated by ;, where a unit after the last applies to all: `5;10;20 N`."""
    parts = text.split(";")
    trailing = re.fullmatch(r"\s*[-+.\deE]+\s*([^-+.\d\seE].*)", parts[-1])
    if trailing:
        parts = [part if re.search(r"[^\d\s.+eE-]", part) else f"{part} {trailing[1]}" for part in parts]
    return [number(part, unit, where, sheet) for part in parts]


def _value(
    text: str, key: str, unit: str, where: str, sheet: DataSheet
) -> float | list[float] | list[tuple[float, ...]]:
    """One number; for plural settings a list a;b;c, for cuts a list of pairs from~to."""
    if key in PAIRS:
        return [tuple(number(end, unit, where, sheet) for end in pair.split("~")) for pair in text.split(";")]
    if key in LISTS:
        return numbers(text, unit, where, sheet)
    if ";" in text:
        raise MotionError(f"{where}: one number expected, got '{text}'")
    return number(text, unit, where, sheet)


Built = TypeVar("Built")  # a motion, or the array of a load


@dataclass(frozen=True)
class Recipe(Generic[Built]):
    """A motion or a load as a line of text specifies it: the function that builds it, and its settings in SI units."""

    kind: str
    builder: Callable[..., Built]
    units: dict[str, str]
    settings: dict[str, object]

    def build(self, *grid: np.ndarray, **overrides: float) -> Built:
        """A load on a time grid (s), or a motion at a `rate` (Hz); `overrides` replace settings."""
        return self.builder(*grid, **self.settings | overrides)

    def numbers(self) -> dict[str, tuple[str, float]]:
        """The scalar settings that may take any value, defaults included: unit and value of each."""
        found = {}
        for name, parameter in inspect.signature(self.builder).parameters.items():
            value = self.settings.get(name, parameter.default)
            if name in self.units and isinstance(value, int | float) and parameter.annotation is not int:
                found[name] = (self.units[name], float(value))
        return found


def _recipe(
    kind: str, text: str, builder: Callable[..., Built], units: dict[str, str], sheet: DataSheet
) -> Recipe[Built]:
    parameters = inspect.signature(builder).parameters
    known = [name for name in parameters if name not in ("time", "rate")]
    settings: dict[str, object] = {}
    for item in filter(None, text.split(",")):
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals or key not in known:
            raise MotionError(f"{kind}: '{item}' is not one of its settings; they are {', '.join(known)}")
        if key in settings:
            raise MotionError(f"{kind}: {key} is given twice")
        settings[key] = _value(value.strip(), key, units[key], f"{kind}: {key}", sheet)
    needed = [name for name in known if parameters[name].default is inspect.Parameter.empty and name not in settings]
    if needed:
        raise MotionError(f"{kind}: still needs {', '.join(needed)}; write {kind}:{needed[0]}=...")
    return Recipe(kind, builder, units, settings)


def motion_recipe(text: str, sheet: DataSheet = NO_SHEET) -> Recipe[Motion] | None:
    """The recipe of `name:key=value,...` (lists with ;); None if `name` is no motion, as for a file.

    By the axis's data sheet numbers may be in units of its motor, `speed=3000rpm`.
    """
    name, _, rest = text.partition(":")
    return _recipe(name, rest, MOTIONS[name], MOTION_UNITS, sheet) if name in MOTIONS else None


def load_recipe(text: str, sheet: DataSheet = NO_SHEET) -> Recipe[np.ndarray] | None:
    """The recipe of `name:key=value,...` (pairs of times as cuts=1~2;3~4); None for a plain number."""
    name, colon, rest = text.partition(":")
    if name in LOADS:
        return _recipe(name, rest, LOADS[name], LOAD_UNITS, sheet)
    if colon:
        require_choice("load", "shape", name, LOADS)
    return None


def parse_motion(text: str, rate: float, sheet: DataSheet = NO_SHEET) -> Motion:
    """A motion from its recipe, or from a CSV file (`motion_file`)."""
    recipe = motion_recipe(text, sheet)
    if recipe is not None:
        return recipe.build(rate=rate)
    path = Path(text)
    if not path.is_file():
        raise MotionError(f"motion: '{text}' is neither a file nor one of the motions {', '.join(MOTIONS)}")
    return parse_motion_table(read_motion(path), str(path), sheet)


def parse_load(text: str, time: np.ndarray, sheet: DataSheet = NO_SHEET) -> np.ndarray:
    """A load from its recipe, or from a number (N)."""
    recipe = load_recipe(text, sheet)
    return load.constant(time, number(text, "N", "load", sheet)) if recipe is None else recipe.build(time)


def require_choice(option: str, noun: str, choice: str, known: Iterable[str]) -> None:
    """Raise `ParameterError` naming the option where the choice is not one of those known."""
    if choice not in known:
        raise ParameterError(f"{option}: no {noun} '{choice}'; known: {', '.join(known)}")


def require_longer_than(settle: float, name: str, motion: Motion) -> None:
    """Raise `ParameterError` unless the motion is longer than the first `settle` seconds."""
    if not 0.0 <= settle < motion.duration:
        raise ParameterError(
            f"settle: {settle:g} s leaves nothing of {name} ({motion.duration:g} s): give less, or a longer motion"
        )
