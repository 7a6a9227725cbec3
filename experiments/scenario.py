"""Motions and loads as one line of text: `triangular:speed=10mm/s,stroke=20mm,rounding=0.3s,duration=4.5s`."""

import contextlib
import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from diffdrive import load, motion
from diffdrive.errors import MotionError
from diffdrive.motion import Motion
from diffdrive.units import to_si

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
_UNITS = {
    "speed": "m/s", "speeds": "m/s", "stroke": "m", "distance": "m", "travel": "m", "amplitude": "m", "amplitudes": "m",
    "start": "m", "acceleration": "m/s^2", "jerk": "m/s^3", "rounding": "s", "ramp": "s", "duration": "s",
    "first_reversal": "s",
    "dwell": "s", "frequency": "Hz", "frequencies": "Hz", "from_frequency": "Hz", "to_frequency": "Hz", "phases": "rad",
    "load": "N", "loads": "N", "to": "N", "before": "N", "at": "s", "times": "s", "workpiece": "kg",
    "removal_rate": "kg/s", "cuts": "s", "repeats": "1",
}  # fmt: skip
_LOAD_UNITS = _UNITS | {"start": "s", "end": "s"}
_LISTS = ("speeds", "amplitudes", "frequencies", "phases", "times", "loads")
_PAIRS = ("cuts",)


def number(text: str, unit: str, where: str) -> float:
    """A number in the SI `unit` from text: bare, or with a unit that converts to it."""
    with contextlib.suppress(ValueError):
        bare = float(text)
        if math.isfinite(bare):
            return bare
    try:
        return to_si(text, unit)
    except ValueError as problem:
        raise MotionError(f"{where}: {problem}") from None


def _value(text: str, key: str, unit: str, where: str) -> Any:
    """One number; for plural settings a list a;b;c, for cuts a list of pairs from~to."""
    if key in _PAIRS:
        return [tuple(number(end, unit, where) for end in pair.split("~")) for pair in text.split(";")]
    numbers = [number(part, unit, where) for part in text.split(";")]
    if key in _LISTS:
        return numbers
    if len(numbers) != 1:
        raise MotionError(f"{where}: one number expected, got '{text}'")
    return numbers[0]


def _arguments(text: str, builder: Callable[..., Any], units: dict[str, str], kind: str) -> dict[str, Any]:
    known = [name for name in inspect.signature(builder).parameters if name not in ("time", "rate")]
    given: dict[str, Any] = {}
    for item in filter(None, text.split(",")):
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals or key not in known:
            raise MotionError(f"{kind}: '{item}' is not one of its settings; they are {', '.join(known)}")
        if key in given:
            raise MotionError(f"{kind}: {key} is given twice")
        given[key] = _value(value.strip(), key, units[key], f"{kind}: {key}")
    required = [
        name
        for name, parameter in inspect.signature(builder).parameters.items()
        if parameter.default is inspect.Parameter.empty and name in known and name not in given
    ]
    if required:
        raise MotionError(f"{kind}: still needs {', '.join(required)}; write {kind}:{required[0]}=...")
    return given


def parse_motion(text: str, rate: float) -> Motion:
    """A motion from `name:key=value,...` (lists with ;), or from a CSV file with the columns time (s), position (m)."""
    name, _, rest = text.partition(":")
    if name in MOTIONS:
        return MOTIONS[name](**_arguments(rest, MOTIONS[name], _UNITS, name), rate=rate)
    path = Path(text)
    if not path.is_file():
        raise MotionError(f"'{text}' is neither a file nor one of the motions {', '.join(MOTIONS)}")
    try:
        table = np.genfromtxt(path, delimiter=",", names=True)
        columns = table.dtype.names or ()
        if "time" not in columns or "position" not in columns:
            raise MotionError(
                f"{path}: needs a header line with the columns time and position, has {', '.join(columns)}"
            )
    except ValueError as error:
        raise MotionError(f"{path}: not a CSV table: {error}") from None
    return motion.from_array(table["time"], table["position"], name=path.name)


def parse_load(text: str, time: np.ndarray) -> np.ndarray:
    """A load from a number (N) or `name:key=value,...`; pairs of times as cuts=1~2;3~4."""
    name, _, rest = text.partition(":")
    if name in LOADS:
        return LOADS[name](time, **_arguments(rest, LOADS[name], _LOAD_UNITS, name))
    return load.constant(time, number(text, "N", "load"))
