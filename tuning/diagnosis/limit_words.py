"""What logs would have shown of each effect, in words."""

import math
from collections.abc import Iterable

from diffdrive.effects.machine import AS_LOGARITHMS, FrictionShape
from diffdrive.support.spans import rescaled
from tuning.diagnosis.detection import DetectionLimit

DIGITS = 2  # of a size: a limit is no measurement


def limit_says(limit: DetectionLimit) -> str:
    """What would have been seen, as in "gap from 0.46 um", and from where on it is told from its nearest rival."""
    if limit.size is None:
        return f"{limit.parameter} at no usual size"
    way = "up to" if limit.weakens else "from"
    seen = f"{limit.parameter} {way} {_sized(limit, limit.size)}"
    if limit.rival is None:
        return seen
    if limit.apart is None:
        return f"{seen}, never told from {limit.rival}"
    return f"{seen}, told from {limit.rival} {way} {_sized(limit, limit.apart)}"


def limits_say(limits: Iterable[DetectionLimit]) -> str:
    """One sentence: the first size of each effect."""
    first: dict[str, DetectionLimit] = {}
    for one in limits:
        first.setdefault(one.effect, one)
    if not first:
        return ""
    each = [f"{name} ({limit_says(one._replace(rival=None))})" for name, one in sorted(first.items())]
    return f"These logs would have shown {', '.join(each)}"


def _sized(limit: DetectionLimit, size: float) -> str:
    if limit.effect == FrictionShape.name and limit.parameter in AS_LOGARITHMS:
        return f"{_rounded(100.0 * math.expm1(size))} %"
    [(value, _, _)], unit = rescaled([(size, None, None)], limit.unit)
    return f"{_rounded(value)}{'' if unit == '1' else ' ' + unit.replace('*', ' ')}"


def _rounded(value: float) -> str:
    return f"{float(f'{value:.{DIGITS}g}'):g}"
