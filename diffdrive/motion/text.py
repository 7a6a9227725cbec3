"""Motions and loads as one line of text: `triangular:speed=10mm/s,stroke=20mm,rounding=0.3s,duration=4.5s`."""

import contextlib
import inspect
import math
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive import motion
from diffdrive.axis import Axis
from diffdrive.errors import MotionError, ParameterError
from diffdrive.motion import load
from diffdrive.motion.file import parse_motion_table, read_motion
from diffdrive.motion.motion import Motion
from diffdrive.support.messages import shortened
from diffdrive.support.units import to_si

RATE_TOLERANCE = 1e-6  # relative: what units and rounding make of one rate
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


def _bare(text: str) -> float | None:
    """A number without a unit; None where the text is none."""
    with contextlib.suppress(ValueError):
        return float(text)
    return None


def number(text: str, unit: str, where: str) -> float:
    """A number in the SI `unit` from text: bare, or with a unit that converts to it."""
    bare = _bare(text)
    if bare is not None and math.isfinite(bare):
        return bare
    if bare is not None and any(one.isdigit() for one in text):  # and not "inf"
        raise MotionError(f"{where}: '{shortened(text)}' is larger than any number that a computer reckons with")
    try:
        return to_si(text, unit)
    except ValueError as problem:
        raise MotionError(f"{where}: {problem}") from None


def require_same_rate(where: str, other: Axis, believed: Axis) -> None:
    """Raises `ParameterError` for a machine or controller of another control rate: its delays are in samples."""
    mine, theirs = other.sampling.rate, believed.sampling.rate
    if abs(mine / theirs - 1.0) > RATE_TOLERANCE:
        raise ParameterError(
            f"{where}: is sampled at {mine:.10g} Hz, the drive file at {theirs:.10g} Hz: delays are given in samples: "
            "make the rates equal"
        )


def nonnegative_number(text: str, unit: str, where: str) -> float:
    """Such a number that is not negative."""
    found = number(text, unit, where)
    if found < 0.0:
        raise MotionError(f"{where} {text}: must be 0 or more")
    return found


def numbers(text: str, unit: str, where: str) -> list[float]:
    """Numbers separated by ;, where a unit behind the last is that of all: `5;10;20 N`."""
    parts = text.split(";")
    trailing = re.fullmatch(r"\s*[-+.\deE]+\s*([^-+.\d\seE].*)", parts[-1])
    if trailing:
        parts = [part if re.search(r"[^\d\s.+eE-]", part) else f"{part} {trailing[1]}" for part in parts]
    return [number(part, unit, where) for part in parts]


def _value(text: str, key: str, unit: str, where: str) -> Any:
    """One number; for plural settings a list a;b;c, for cuts a list of pairs from~to."""
    if key in PAIRS:
        return [tuple(number(end, unit, where) for end in pair.split("~")) for pair in text.split(";")]
    if key in LISTS:
        return numbers(text, unit, where)
    if ";" in text:
        raise MotionError(f"{where}: one number expected, got '{text}'")
    return number(text, unit, where)


@dataclass(frozen=True)
class Recipe:
    """A motion or a load as a line of text tells it: the function that makes it, and its settings in SI units."""

    kind: str
    builder: Callable[..., Any]
    units: dict[str, str]
    settings: dict[str, Any]

    def build(self, *grid: np.ndarray, **more: float) -> Any:
        """A load on a grid of times, or a motion at a `rate`; settings that are given here replace its own."""
        return self.builder(*grid, **self.settings | more)

    def numbers(self) -> dict[str, tuple[str, float]]:
        """The settings that are one number which may take any value, with unit and value; defaults are among them."""
        found = {}
        for name, parameter in inspect.signature(self.builder).parameters.items():
            value = self.settings.get(name, parameter.default)
            if name in self.units and isinstance(value, int | float) and parameter.annotation is not int:
                found[name] = (self.units[name], float(value))
        return found


def _recipe(kind: str, text: str, make: Callable[..., Any], units: dict[str, str]) -> Recipe:
    parameters = inspect.signature(make).parameters
    known = [name for name in parameters if name not in ("time", "rate")]
    given: dict[str, Any] = {}
    for item in filter(None, text.split(",")):
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals or key not in known:
            raise MotionError(f"{kind}: '{item}' is not one of its settings; they are {', '.join(known)}")
        if key in given:
            raise MotionError(f"{kind}: {key} is given twice")
        given[key] = _value(value.strip(), key, units[key], f"{kind}: {key}")
    needed = [name for name in known if parameters[name].default is inspect.Parameter.empty and name not in given]
    if needed:
        raise MotionError(f"{kind}: still needs {', '.join(needed)}; write {kind}:{needed[0]}=...")
    return Recipe(kind, make, units, given)


def motion_recipe(text: str) -> Recipe | None:
    """What `name:key=value,...` (lists with ;) tells; None where it is no motion of ours, but a file perhaps."""
    name, _, rest = text.partition(":")
    return _recipe(name, rest, MOTIONS[name], MOTION_UNITS) if name in MOTIONS else None


def load_recipe(text: str) -> Recipe | None:
    """What `name:key=value,...` (pairs of times as cuts=1~2;3~4) tells; None where it is a number."""
    name, colon, rest = text.partition(":")
    if name in LOADS:
        return _recipe(name, rest, LOADS[name], LOAD_UNITS)
    if colon:
        require_choice("--load", "shape", name, LOADS)
    return None


def parse_motion(text: str, rate: float) -> Motion:
    """A motion from its recipe, or from a CSV file (`motion_file`)."""
    recipe = motion_recipe(text)
    if recipe is not None:
        return recipe.build(rate=rate)
    path = Path(text)
    if not path.is_file():
        raise MotionError(f"--motion: '{text}' is neither a file nor one of the motions {', '.join(MOTIONS)}")
    return parse_motion_table(read_motion(path), str(path))


def parse_load(text: str, time: np.ndarray) -> np.ndarray:
    """A load from its recipe, or from a number (N)."""
    recipe = load_recipe(text)
    return load.constant(time, number(text, "N", "--load")) if recipe is None else recipe.build(time)


def require_choice(option: str, what: str, given: str, known: Iterable[str]) -> None:
    """Raise `ParameterError` naming the option where what was given is not one of those known."""
    if given not in known:
        raise ParameterError(f"{option}: no {what} '{given}'; known: {', '.join(known)}")


def require_longer_than(settle: float, name: str, motion: Motion) -> None:
    """Raise `ParameterError` unless something of the motion is left after the first `settle` seconds."""
    if not 0.0 <= settle < motion.duration:
        raise ParameterError(
            f"--settle: {settle:g} s leaves nothing of {name} ({motion.duration:g} s): give less, or a longer motion"
        )
