"""What logs would show of each effect, in words."""

import math
from collections.abc import Iterable

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.machine import AS_LOGARITHMS, FrictionShape
from diffdrive.support.spans import rescaled
from tuning.diagnosis.limits.detection import DetectionLimit
from tuning.diagnosis.limits.isolability import Rivalry

DIGITS = 2  # of a size: a limit is no measurement


def limit_says(limit: DetectionLimit) -> str:
    """What would be seen, as in "gap from 0.46 um"."""
    if limit.size is None:
        return f"{limit.parameter}: at no usual size"
    return f"{limit.parameter} {'up to' if limit.weakens else 'from'} {_sized(limit, limit.size)}"


def rivalry_says(one: Rivalry) -> str:
    """Up to which size an effect may be another, as in "cogging, amplitude from 0.2 N to 3 N, may be lead_error"."""
    seen, isolable = one.seen, one.isolable
    up_to = "" if isolable is None else f" to {_sized(seen, isolable)}"
    return (
        f"{seen.effect}, {seen.parameter} from {_sized(seen, seen.size or 0.0)}{up_to}, may be {one.rival}, which does "
        f"{100.0 * one.share:.0f} % of the same"
    )


def limits_say(limits: Iterable[DetectionLimit]) -> str:
    """One sentence: of each effect the first size that would show, then those of which none would."""
    first: dict[str, DetectionLimit] = {}
    for one in sorted(limits, key=lambda limit: limit.size is None):
        first.setdefault(one.effect, one)
    shown = [f"{name} ({limit_says(one)})" for name, one in sorted(first.items()) if one.size is not None]
    hidden = [name for name, one in sorted(first.items()) if one.size is None]
    says = f"These logs would show {', '.join(shown)}" if shown else ""
    none = f"at no usual size {', '.join(hidden)}" if hidden else ""
    return "; ".join(part for part in (says, none) if part)


def _sized(limit: DetectionLimit, size: float) -> str:
    if limit.effect == FrictionShape.name and limit.parameter in AS_LOGARITHMS:
        return f"{_rounded(100.0 * math.expm1(size))} %"
    if limit.effect == LoopDelay.name:
        return f"{_rounded(size)} control periods"
    if limit.unit == "1":
        return f"{_rounded(100.0 * size)} %"
    [(value, _, _)], unit = rescaled([(size, None, None)], limit.unit)
    return f"{_rounded(value)} {unit.replace('*', ' ')}"


def _rounded(value: float) -> str:
    return f"{float(f'{value:.{DIGITS}g}'):g}"
