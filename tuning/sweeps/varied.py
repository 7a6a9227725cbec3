"""What varies in a sweep, and how: one line of text for each quantity, as `plant.mass=lognormal:3%`."""

import dataclasses
import difflib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float, PyTree
from scipy import stats

from diffdrive.effects.catalogue import EFFECTS
from diffdrive.effects.data_sheet import neutral
from diffdrive.errors import ParameterError
from diffdrive.model.data_sheet import NO_SHEET, DataSheet
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantities
from diffdrive.model.uncertainty import MAX_LOG_DEVIATION
from diffdrive.motion.text import number, numbers

# Beside what the drive file holds: a load that changes linearly between two times, and is constant outside.
LOAD = {"load": "N", "load.change": "N", "load.change.begin": "s", "load.change.end": "s"}
# Numbers in percent are offsets from the drive file's value, and need a sign but for a range's last: -5%..+5%.
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
MAX_SIGMAS = 4.0  # standard deviations: no sample is decided by a machine that nobody will see

Values = Float[np.ndarray, " n"]
Mode = Literal["is", "plus", "times"]  # how a number meets the drive file's value


@dataclass(frozen=True)
class VariedQuantity:
    """A quantity and its distribution: `of` gives numbers at shares (0 to 1) of the probability.

    `how` they meet the drive file's value: they are the value, are added to it, or are factors on it.
    """

    name: str
    unit: str
    text: str
    mode: Mode
    quantile: Callable[[Values], Values]

    def apply(self, value: PyTree, drawn: Values) -> Values:
        """A value as the files have it, under what was drawn."""
        if self.mode == "is":
            return drawn
        return value + drawn if self.mode == "plus" else value * drawn


def _normal(share: Values, low: float = -MAX_SIGMAS, high: float = MAX_SIGMAS) -> Values:
    return np.asarray(stats.truncnorm.ppf(share, low, high))


def _uniform(low: float, high: float) -> Callable[[Values], Values]:
    return lambda share: low + (high - low) * share


def _loguniform(low: float, high: float) -> Callable[[Values], Values]:
    return lambda share: low * (high / low) ** share


def _triangular(low: float, mode: float, high: float) -> Callable[[Values], Values]:
    return lambda share: np.asarray(stats.triang.ppf(share, (mode - low) / (high - low), low, high - low))


def _quantile_function(kind: str, values_given: list[float], bounds: tuple[float, float]) -> Callable[[Values], Values]:
    """The distribution of a kind; a normal one ends where the quantity does."""
    if kind == "uniform":
        return _uniform(*values_given)
    if kind == "loguniform":
        return _loguniform(*values_given)
    if kind == "triangular":
        return _triangular(*values_given)
    if kind == "fixed":
        return lambda share: np.full(share.shape, values_given[0])
    middle, deviation = values_given
    if kind == "normal":
        low, high = (float(np.clip((bound - middle) / deviation, -MAX_SIGMAS, MAX_SIGMAS)) for bound in bounds)
        return lambda share: middle + deviation * _normal(share, low, high)
    return lambda share: middle * np.exp(deviation * _normal(share))


def with_effects(drive: Drive, names: Iterable[str], sheet: DataSheet = NO_SHEET) -> Drive:
    """The drive, and those effects that it has not yet, neutral, with what its data sheet states of them."""
    there = {effect.name for effect in drive.effects}
    wanted = [name for name in EFFECTS if name in set(names) - there]
    return dataclasses.replace(drive, effects=(*drive.effects, *(neutral(EFFECTS[name], sheet) for name in wanted)))


class KnownQuantity(NamedTuple):
    """A quantity that may vary."""

    unit: str
    values: tuple[float, ...]  # that the drive has of it, one or one per direction; none where it has none
    bounds: tuple[float, float] = (-np.inf, np.inf)  # which it may not leave

    @property
    def is_scalable(self) -> bool:
        """Whether it has values to be relative to."""
        return bool(self.values) and all(value != 0.0 for value in self.values)

    def drawn_bounds(self, how: Mode) -> tuple[float, float]:
        """The bounds of what meets the drive's values: of the value itself, an offset or a factor."""
        ends = np.array([self.bounds] * max(1, len(self.values)))
        if how == "plus":
            ends = ends - np.reshape(self.values, (-1, 1))
        elif how == "times":
            ends = np.sort(ends / np.reshape(self.values, (-1, 1)), axis=1)
        return float(ends[:, 0].max()), float(ends[:, 1].min())


def known_quantities(drive: Drive, sheet: DataSheet = NO_SHEET) -> dict[str, KnownQuantity]:
    """Every quantity that may vary.

    A quantity per direction stands for both sides together, or for one of them with `.positive` or `.negative`. Effects
    that the drive file has not are there as well.
    """
    known = {name: KnownQuantity(unit, (0.0,)) for name, unit in LOAD.items()}
    for name, declared, value in quantities(with_effects(drive, EFFECTS, sheet)):
        sides = ("positive", "negative") if declared.directional else ()
        values = () if value is None else tuple(float(getattr(value, side)) for side in sides) or (float(value),)
        known[name] = KnownQuantity(declared.unit, values, declared.range)
        for k, side in enumerate(sides):
            known[f"{name}.{side}"] = KnownQuantity(declared.unit, values[k : k + 1], declared.range)
    return known


def parse_varied(
    text: str,
    drive: Drive,
    settings: Mapping[str, KnownQuantity] = MappingProxyType({}),
    sheet: DataSheet = NO_SHEET,
) -> VariedQuantity:
    """A quantity and its distribution from `NAME=KIND:NUMBERS`; numbers in percent are relative to the drive file's.

    `settings` are those of motions and load that may vary, too. Raises `ParameterError` that says what is known.
    """
    name, equals, rest = text.partition("=")
    name, (kind, _, values) = name.strip(), (part.strip() for part in rest.partition(":"))
    known = known_quantities(drive, sheet) | dict(settings)
    if not equals:
        raise ParameterError(f"vary: '{text}' has no distribution; write for example '{name}=uniform:-5%..5%'")
    if name not in known:
        of = name.partition(".")[0]
        if of in ("motion", "load"):
            there = ", ".join(key for key in known if key.startswith(of)) or "none"
            raise ParameterError(
                f"vary: '{name}' is no setting that {'every motion' if of == 'motion' else 'the load over time'} has "
                f"as one number; those that may vary are {there}"
            )
        near = difflib.get_close_matches(name, known, 3)
        hint = f"near it are {', '.join(near)}" if near else "such are plant.mass, friction.viscous, load"
        raise ParameterError(f"vary: '{name}' is no quantity of this drive; {hint}")
    unit, label = known[name].unit, f"vary {name}"
    if kind not in KINDS:
        kinds = "; ".join(f"{key}:{what}" for key, what in KINDS.items())
        raise ParameterError(f"{label}: '{kind}' is no distribution; known: {kinds}")
    parts = [part.strip() for part in values.split("..")]
    if len(parts) not in NUMBERS[kind] or not all(parts):
        raise ParameterError(f"{label}: '{values}' is not what {kind} takes; write {kind}:{KINDS[kind]}")
    mode, values_given = _mode_and_numbers(kind, parts, unit, label, sheet)
    if (mode == "times" and not known[name].is_scalable) or (mode == "plus" and not known[name].values):
        raise ParameterError(f"{label}: has no value, or zero, to be relative to: give all numbers in {unit}")
    _require_sensible(kind, values_given, label)
    low, high = known[name].drawn_bounds(mode)
    if (
        kind == "normal"
        and not low - MAX_SIGMAS * values_given[1] < values_given[0] < high + MAX_SIGMAS * values_given[1]
    ):
        raise ParameterError(f"{label}: nothing of {values} is from {low:g} to {high:g}, where it must be")
    return VariedQuantity(name, unit, text, mode, _quantile_function(kind, values_given, (low, high)))


def _mode_and_numbers(kind: str, parts: list[str], unit: str, label: str, sheet: DataSheet) -> tuple[Mode, list[float]]:
    """How the numbers of a kind meet the drive file's value, and the numbers, a single deviation with its middle."""
    places, deviation = (parts[:-1], parts[-1]) if kind in ("normal", "lognormal") else (parts, None)
    shares = [part.endswith("%") for part in places]
    relative = all(shares) and (bool(places) or kind == "lognormal" or str(deviation).endswith("%"))
    if any(shares) and not relative:
        raise ParameterError(f"{label}: '{'..'.join(parts)}' mixes percent and {unit}: give all in one of them")
    for part in places[: max(1, len(places) - 1)]:
        if relative and part[0] not in "+-" and part != "0%":
            raise ParameterError(
                f"{label}: '{part}' needs a sign: percents are offsets from the drive file's value, as -5%..+5%"
            )
    if relative:
        values_given = [1.0 + _fraction(part, label) for part in places] or [1.0]
        return "times", values_given if deviation is None else [*values_given, _fraction(deviation, label)]
    if kind == "lognormal":
        return "is", [*numbers(places[0], unit, label, sheet), _fraction(parts[-1], label)]
    values_given = numbers(";".join(parts), unit, label, sheet)
    return ("is", values_given) if places else ("plus", [0.0, *values_given])


def _fraction(text: str, label: str) -> float:
    """A share, in percent or bare."""
    percent = text.endswith("%")
    return number(text.removesuffix("%"), "1", label) / (100.0 if percent else 1.0)


def _require_sensible(kind: str, values_given: list[float], label: str) -> None:
    """Ranges rise, logarithms are of positive numbers, deviations are not negative."""
    if kind in ("uniform", "loguniform", "triangular"):
        rises = values_given[0] < values_given[-1] and values_given == sorted(values_given)
        if not rises:
            raise ParameterError(
                f"{label}: the numbers of {kind} must rise, got {', '.join(f'{x:g}' for x in values_given)}"
            )
    if kind in ("loguniform", "lognormal") and not values_given[0] > 0.0:
        raise ParameterError(f"{label}: {kind} needs numbers above zero, got {values_given[0]:g}")
    if kind in ("normal", "lognormal") and not values_given[-1] > 0.0:
        raise ParameterError(f"{label}: the deviation must be above zero, got {values_given[-1]:g}")
    if kind == "lognormal" and values_given[-1] > MAX_LOG_DEVIATION:
        wide = f"a deviation of {100 * values_given[-1]:g} % of a logarithm is too wide"
        raise ParameterError(f"{label}: {wide}; write 3% or 0.03")
