"""What varies in a sweep, and how: one line of text for each quantity, as `plant.mass=lognormal:3%`."""

import dataclasses
import difflib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy import stats

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.errors import ParameterError
from diffdrive.parameters import Drive, quantities
from experiments.scenario import number, numbers

# Beside what the drive file holds: a load that changes linearly between two times, and is constant outside.
LOAD = {"load": "N", "load.change": "N", "load.from": "s", "load.to": "s"}
KINDS = {
    "uniform": "LOW..HIGH, every value alike",
    "loguniform": "LOW..HIGH, every order of magnitude alike",
    "triangular": "LOW..MODE..HIGH",
    "normal": "DEVIATION about the drive file's value, or MEAN..DEVIATION",
    "lognormal": "DEVIATION of the logarithm about the drive file's value, or MEDIAN..DEVIATION",
    "fixed": "VALUE, another than the drive file's",
}
NUMBERS = {
    "uniform": (2,), "loguniform": (2,), "triangular": (3,), "normal": (1, 2), "lognormal": (1, 2), "fixed": (1,),
}  # fmt: skip
FARTHEST = 4.0  # standard deviations: no sample is decided by a machine that nobody will see

Values = Float[np.ndarray, " n"]


@dataclass(frozen=True)
class Varied:
    """A quantity and its distribution: `of` gives numbers at shares (0 to 1) of the probability.

    `how` they meet the drive file's value: they are the value, are added to it, or are factors on it.
    """

    name: str
    unit: str
    text: str
    how: Literal["is", "plus", "times"]
    of: Callable[[Values], Values]


def _normal(share: Values) -> Values:
    return np.asarray(stats.truncnorm.ppf(share, -FARTHEST, FARTHEST))


def _uniform(low: float, high: float) -> Callable[[Values], Values]:
    return lambda share: low + (high - low) * share


def _loguniform(low: float, high: float) -> Callable[[Values], Values]:
    return lambda share: low * (high / low) ** share


def _triangular(low: float, mode: float, high: float) -> Callable[[Values], Values]:
    return lambda share: np.asarray(stats.triang.ppf(share, (mode - low) / (high - low), low, high - low))


def _shape(kind: str, given: list[float]) -> Callable[[Values], Values]:
    """The distribution of a kind."""
    if kind == "uniform":
        return _uniform(*given)
    if kind == "loguniform":
        return _loguniform(*given)
    if kind == "triangular":
        return _triangular(*given)
    if kind == "fixed":
        return lambda share: np.full(share.shape, given[0])
    middle, deviation = given
    if kind == "normal":
        return lambda share: middle + deviation * _normal(share)
    return lambda share: middle * np.exp(deviation * _normal(share))


def with_effects(drive: Drive, names: Iterable[str]) -> Drive:
    """The drive, and those effects that it has not yet, neutral."""
    there = {effect.name for effect in drive.effects}
    wanted = [name for name in EFFECTS if name in set(names) - there]
    return dataclasses.replace(drive, effects=(*drive.effects, *(EFFECTS[name]() for name in wanted)))


def known_quantities(drive: Drive) -> dict[str, tuple[str, bool]]:
    """Unit of every quantity that may vary, and whether the drive has a value of it that is not zero.

    A quantity per direction stands for both sides together, or for one of them with `.positive` or `.negative`. Effects
    that the drive file has not are there as well.
    """
    known = {name: (unit, False) for name, unit in LOAD.items()}
    for name, declared, value in quantities(with_effects(drive, EFFECTS)):
        sides = [] if value is None else [value.positive, value.negative] if declared.directional else [value]
        known[name] = (declared.unit, bool(sides) and all(float(one) != 0.0 for one in sides))
        if declared.directional:
            known |= {f"{name}.{side}": known[name] for side in ("positive", "negative")}
    return known


def parse_varied(text: str, drive: Drive) -> Varied:
    """A quantity and its distribution from `NAME=KIND:NUMBERS`; numbers in percent are relative to the drive file's.

    Raises `ParameterError` that says what is known.
    """
    name, equals, rest = text.partition("=")
    name, (kind, _, values) = name.strip(), (part.strip() for part in rest.partition(":"))
    known = known_quantities(drive)
    if not equals or name not in known:
        near = difflib.get_close_matches(name, known, 3) or ["plant.mass", "friction.viscous", "load"]
        raise ParameterError(f"vary: '{name}' is no quantity of this drive; near it are {', '.join(near)}")
    unit, has_value = known[name]
    where = f"vary {name}"
    if kind not in KINDS:
        kinds = "; ".join(f"{key}:{what}" for key, what in KINDS.items())
        raise ParameterError(f"{where}: '{kind}' is no distribution; known: {kinds}")
    parts = [part.strip() for part in values.split("..")]
    if len(parts) not in NUMBERS[kind] or not all(parts):
        raise ParameterError(f"{where}: '{values}' is not what {kind} takes; write {kind}:{KINDS[kind]}")
    relative = all(part.endswith("%") for part in parts)
    alone = kind in ("normal", "lognormal") and len(parts) == 1
    if (relative or alone) and not has_value:
        raise ParameterError(
            f"{where}: the drive file has no value for it, or zero, to be relative to: give all numbers in {unit}"
        )
    if kind == "lognormal":
        middle = [] if alone else [number(parts[0], unit, where)]
        given = [*(middle or [1.0]), _share(parts[-1], where)]
        how: Literal["is", "plus", "times"] = "times" if alone else "is"
    elif relative:
        about = {"loguniform": 0.0}.get(kind, 1.0)
        given = [about + _share(part, where) for part in parts]
        given, how = ([1.0, given[0] - 1.0] if alone else given), "times"
    else:
        given = numbers(";".join(parts), unit, where)
        given, how = ([0.0, *given] if alone else given), "plus" if alone else "is"
    _require_sensible(kind, given, where)
    return Varied(name, unit, text, how, _shape(kind, given))


def _share(text: str, where: str) -> float:
    """A share, in percent or bare."""
    percent = text.endswith("%")
    return number(text.removesuffix("%"), "1", where) / (100.0 if percent else 1.0)


def _require_sensible(kind: str, given: list[float], where: str) -> None:
    """Ranges rise, logarithms are of positive numbers, deviations are not negative."""
    if kind in ("uniform", "loguniform", "triangular"):
        rises = given[0] < given[-1] and given == sorted(given)
        if not rises:
            raise ParameterError(f"{where}: the numbers of {kind} must rise, got {', '.join(f'{x:g}' for x in given)}")
    if kind in ("loguniform", "lognormal") and not given[0] > 0.0:
        raise ParameterError(f"{where}: {kind} needs numbers above zero, got {given[0]:g}")
    if kind in ("normal", "lognormal") and not given[-1] > 0.0:
        raise ParameterError(f"{where}: the deviation must be above zero, got {given[-1]:g}")
