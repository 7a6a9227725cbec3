"""The effects by name and by part of the machine, and `register` for further ones."""

import dataclasses
from collections.abc import Iterable
from typing import TypeVar

from diffdrive.effects.actuator import ActuatorLag, ForceGain, ForceLimit, LoopDelay
from diffdrive.effects.base import Effect
from diffdrive.effects.forces import Cogging, ConstantForce, FrameVibration, PositionSpring, ProcessForce
from diffdrive.effects.friction import AppliedLoad, FrictionDwell, PositionFriction, PreslidingHysteresis, ViscousDrift
from diffdrive.effects.machine import FrictionAsymmetry, FrictionShape, PayloadMass
from diffdrive.effects.scale import InterpolationError, LeadError
from diffdrive.effects.transmission import Backlash, Compliance
from diffdrive.errors import ParameterError
from diffdrive.model.data_sheet import NO_SHEET
from diffdrive.model.parameters import require_compatible
from diffdrive.support.messages import short_repr, suggestion
from diffdrive.support.registry import Registry

EffectType = TypeVar("EffectType", bound=Effect)

_BUILT_IN: dict[str, tuple[type[Effect], ...]] = {
    "friction": (
        AppliedLoad,
        FrictionShape,
        FrictionAsymmetry,
        PositionFriction,
        ViscousDrift,
        FrictionDwell,
        PreslidingHysteresis,
    ),
    "plant": (PayloadMass, ConstantForce, PositionSpring),
    "transmission": (Compliance, Backlash),
    "environment": (FrameVibration, ProcessForce),
    "actuator": (Cogging, ForceGain, ActuatorLag, LoopDelay, ForceLimit),
    "sensor": (LeadError, InterpolationError),
}
PARTS = tuple(_BUILT_IN)  # of a machine
EFFECTS: Registry[type[Effect]] = Registry(
    "effect",
    {effect.name: effect for part_effects in _BUILT_IN.values() for effect in part_effects},
    pattern=r"[^\W\d]\w*",
    hint="a word, as it stands in a drive file",
)
"""Every known effect by its name in a drive file."""


def register(effect: type[EffectType]) -> type[EffectType]:
    """Make an effect of your own known, as a decorator of its class.

    `simulate`, drive files, `sweep` and `diagnose` then treat it as they do those of the catalogue.

    Its `name` is that of its table in a drive file ([effects.NAME]), its `part` the part of the machine that it is
    reported as, one of `PARTS`. A class of your own is replaced by one that is registered under its name. An effect is
    neutral, and does nothing, at its defaults.

    Args:
        effect: A class derived from `TableForce` or another of the base classes.

    Raises:
        ParameterError: The class has no name, that of an effect of the catalogue, an unknown part, a parameter that
            declares neither unit nor meaning, or one without a default.

    Examples:
        >>> @register
        ... class Counterbalance(TableForce):
        ...     name = "counterbalance"
        ...     force: float = amplitude("N", "force of the counterbalance", usual=20.0)
        ...
        ...     def push(self, seen):
        ...         return self.force

    """
    name = getattr(effect, "name", None)
    if not isinstance(name, str):
        raise ParameterError(f"{effect.__name__}.name: must be a word, as it stands in a drive file, got {name!r}")
    if effect.part not in PARTS:
        raise ParameterError(f"effect {name}: no part '{effect.part}' of a machine; known: {', '.join(PARTS)}")
    for field in dataclasses.fields(effect):
        if "quantity" not in field.metadata:
            raise ParameterError(f"effect {name}: declare {field.name} with its unit and meaning, as by `amplitude`")
        if field.default is dataclasses.MISSING:
            raise ParameterError(f"effect {name}: {field.name} needs a default; with all of them it does nothing")
    for parameter, key in effect.from_sheet.items():
        if not hasattr(effect, parameter) or not hasattr(NO_SHEET, key):
            raise ParameterError(f"effect {name}: from_sheet: no parameter '{parameter}', or no key '{key}' of [axis]")
    EFFECTS.add(name, effect)
    return effect


def require_effects(names: Iterable[str], where: str) -> None:
    """Raise `ParameterError` for a name that no effect has; `where`, an argument or an option, begins the message."""
    if isinstance(names, str):
        raise ParameterError(f"{where}: must be a list of names, such as [{names!r}], got {short_repr(names)}")
    for name in names:
        if name not in EFFECTS:
            raise ParameterError(f"{where}: no effect {short_repr(name)}; {suggestion(str(name), EFFECTS)}")


def effects_by_part() -> dict[str, tuple[type[Effect], ...]]:
    """Every known effect, by the part of the machine that it belongs to."""
    built_in = [effect for effects in _BUILT_IN.values() for effect in effects]
    own = [effect for effect in EFFECTS.values() if effect not in built_in]
    return {part: (*effects, *(e for e in own if e.part == part)) for part, effects in _BUILT_IN.items()}


def part_of(effect: Effect) -> str:
    """The part of the machine that an effect belongs to, one of `PARTS`."""
    return next((part for part, effects in effects_by_part().items() if type(effect) in effects), effect.part)


def in_order(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Effects in the catalogue's order: drive files know no other.

    Raises `ParameterError` for one not in it, and for those that no machine has beside each other.
    """
    effects, names = tuple(effects), list(EFFECTS)
    for effect in effects:
        if not isinstance(effect, Effect):
            raise ParameterError(
                f"effects: must be effects, such as ConstantForce(force=5.0), got {short_repr(effect)}"
            )
        if getattr(effect, "name", None) not in EFFECTS:
            raise ParameterError(
                f"effects: the catalogue has no {type(effect).__name__}: register its class, by "
                "@diffdrive.effects.register"
            )
    require_compatible(effects)
    return tuple(sorted(effects, key=lambda effect: names.index(effect.name)))
