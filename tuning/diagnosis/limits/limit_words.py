"""What logs would show of each effect, in words."""

import math
from collections.abc import Iterable

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.machine import AS_LOGARITHMS, FrictionShape
from diffdrive.support.spans import MAX_DIGITS, rescaled
from tuning.diagnosis.limits.detection import AMPLITUDE, DetectionLimit
from tuning.diagnosis.limits.isolability import Rivalry

DIGITS = 2  # of a size: a limit is no measurement
PLAIN = 6  # digits before the point, beyond which a number is written with a power of ten


def limit_says(limit: DetectionLimit) -> str:
    """What would be seen, as in "gap from 0.46 um"."""
    if limit.size is None:
        return f"{limit.parameter}: at no usual size"
    return f"{limit.parameter} {'up to' if limit.weakens else 'from'} {_sized(limit, limit.size)}"


def rivalry_says(one: Rivalry) -> str:
    """Up to which size an effect may be another, as in "tilt, force from 2 N to 3 N: sag, ..., is not excluded".

    A rival that does little of the same may not be excluded either: the share of a wave is of all its phases, and the
    hardest one decides; and an effect of more numbers has to gain more than its rival.
    """
    seen, is_wave = one.seen, one.seen.parameter == AMPLITUDE
    return (
        f"{seen.effect}, {seen.parameter} {_range(seen, seen.size or 0.0, one.isolable)}: {one.rival}, which does "
        f"{100.0 * one.share:.0f} % of the same{' on average over the phases' if is_wave else ''}, is not excluded"
        f"{' at the hardest phase' if is_wave else ''}"
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


def _range(limit: DetectionLimit, low: float, high: float | None) -> str:
    """From one size to another, or on; with as many digits as show that they differ."""
    if high is None:
        return f"from {_sized(limit, low)} on"
    for digits in range(DIGITS, MAX_DIGITS + 1):
        ends = [_sized(limit, one, digits) for one in (low, high)]
        if ends[0] != ends[1]:
            return f"from {ends[0]} to {ends[1]}"
    return f"of {_sized(limit, low)}"


def _sized(limit: DetectionLimit, size: float, digits: int = DIGITS) -> str:
    if limit.effect == FrictionShape.name and limit.parameter in AS_LOGARITHMS:
        return f"{_rounded(100.0 * math.expm1(size), digits)} %"
    if limit.effect == LoopDelay.name:
        return f"{_rounded(size, digits)} control periods"
    if limit.unit == "1":
        return f"{_rounded(100.0 * size, digits)} %"
    [(value, _, _)], unit = rescaled([(size, None, None)], limit.unit)
    return f"{_rounded(value, digits)} {unit.replace('*', ' ')}"


def _rounded(value: float, digits: int) -> str:
    return f"{float(f'{value:.{digits}g}'):.{max(digits, PLAIN)}g}"
