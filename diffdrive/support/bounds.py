"""Numbers of a caller within their range: refused by the argument's name before anything is computed."""

import math
import operator

from diffdrive.errors import ParameterError
from diffdrive.support.messages import short_repr


def require_number(
    name: str,
    value: object,
    unit: str = "",
    *,
    above: float | None = None,
    at_least: float | None = None,
    at_most: float | None = None,
    hint: str = "",
) -> None:
    """Raise `ParameterError` unless `value` is a finite number within these bounds, which are in the unit.

    `hint` ends the message: what is usual, or what else may be given.
    """
    try:
        number = math.nan if isinstance(value, bool | str) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    within = (
        math.isfinite(number)
        and (above is None or number > above)
        and (at_least is None or number >= at_least)
        and (at_most is None or number <= at_most)
    )
    if not within:
        text = f"{name}: must be {_range_text(above, at_least, at_most)} {unit}".rstrip()
        raise ParameterError(f"{text}, got {short_repr(value)}{hint and f'; {hint}'}")


def require_a(kind: type, name: str, value: object, hint: str = "") -> None:
    """Raise `ParameterError` unless `value` is of this kind: else its first missing attribute would be the message."""
    if not isinstance(value, kind):
        article = "an" if kind.__name__[0] in "AEIO" else "a"
        text = f"{name}: must be {article} {kind.__name__}, got {short_repr(value)}"
        raise ParameterError(text + (hint and f"; {hint}"))


def require_count(name: str, value: object, at_least: int = 1, at_most: int | None = None) -> None:
    """Raise `ParameterError` unless `value` is a whole number within these bounds."""
    try:
        number = None if isinstance(value, bool) else operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        number = None
    if number is None or number < at_least or (at_most is not None and number > at_most):
        ending = "on" if at_most is None else f"to {at_most}"
        raise ParameterError(f"{name}: must be a whole number from {at_least} {ending}, got {short_repr(value)}")


def _range_text(above: float | None, at_least: float | None, at_most: float | None) -> str:
    if at_least is not None and at_most is not None:
        return f"from {at_least:g} to {at_most:.3g}"
    bounds = [
        f"{word} {bound:.3g}"
        for word, bound in (("above", above), ("at least", at_least), ("at most", at_most))
        if bound is not None
    ]
    return " and ".join(bounds) or "a finite number"
