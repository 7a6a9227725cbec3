"""What an axis's data sheet states of its effects, so that a drive file need not state it twice."""

import dataclasses
import math
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import PyTree

from diffdrive.effects.base import Effect
from diffdrive.errors import ParameterError
from diffdrive.model.data_sheet import DataSheet

SAME = 1e-9  # relative, within which two numbers are one that was written in different units


class Contradiction(NamedTuple):
    """A parameter of an effect that differs from what the data sheet says it is."""

    path: str  # of the parameter, "effects.lead_error.lead"
    value: float
    key: str  # of [axis]
    stated: float

    def __str__(self) -> str:
        return (
            f"{self.path} is {self.value:.6g}, and [axis] {self.key} {self.stated:.6g}: they are one and the same; "
            "leave out either"
        )


def stated_parameters(sheet: DataSheet, effect: type[Effect]) -> dict[str, float]:
    """The parameters of an effect that the data sheet states."""
    stated = {name: getattr(sheet, key) for name, key in effect.from_sheet.items()}
    return {name: value for name, value in stated.items() if value is not None}


def neutral(effect: type[Effect], sheet: DataSheet) -> Effect:
    """An effect that does nothing, with what the data sheet states of it."""
    return effect(**stated_parameters(sheet, effect))


def contradictions(effects: Iterable[PyTree], sheet: DataSheet) -> Iterator[Contradiction]:
    """The parameters that differ from what the data sheet states; those traced, or of several machines, are skipped."""
    for effect in effects:
        for name, stated in stated_parameters(sheet, type(effect)).items():
            value = getattr(effect, name)
            if isinstance(value, jax.core.Tracer) or np.ndim(value):
                continue
            if not math.isclose(float(value), stated, rel_tol=SAME):
                yield Contradiction(f"effects.{effect.name}.{name}", float(value), effect.from_sheet[name], stated)


def require_agreement(effects: Iterable[PyTree], sheet: DataSheet) -> None:
    """Raise `ParameterError`, which names both keys, where an effect says another number than the data sheet."""
    for contradiction in contradictions(effects, sheet):
        raise ParameterError(str(contradiction))


def without_contradicted(sheet: DataSheet, effects: Iterable[PyTree]) -> DataSheet:
    """The data sheet without what effects contradict: such as a lead that a sweep varies, or a diagnosis estimates."""
    absent: dict[str, Any] = {one.key: None for one in contradictions(effects, sheet)}
    return dataclasses.replace(sheet, **absent)
