"""A number with its interval as text: digits by the interval's width, in a unit that leaves few zeros."""

import math
from collections.abc import Sequence

INTERVAL_DIGITS = 2  # digits of half an interval's width (GUM, 7.2.6)
PLAIN_DIGITS = 4  # digits of a number without an interval
MAX_DIGITS = 8  # digits of any number
FIXED_RANGE = (1e-4, 1e7)  # written without a power of ten; others with one that is a multiple of three
SUBMULTIPLES = {
    "m": ((1e-4, 1e6, "um"), (1.0, 1e3, "mm")),
    "m/s": ((1.0, 1e3, "mm/s"),),
    "s": ((1e-4, 1e6, "us"), (0.1, 1e3, "ms")),
}  # by unit: the limit below which a smaller unit is used, how many make one, and its name

Span = tuple[float, float | None, float | None]  # a number, and its interval where one is known


def format_span(span: Span) -> tuple[str, str, str]:
    """The number and the ends of its interval, all to the same place; "-" for an end that is not known."""
    value, low, high = span
    half = 0.0 if low is None or high is None else float(f"{0.5 * (high - low):.{INTERVAL_DIGITS - 1}e}")
    if value is None or not (math.isfinite(value) and 0.0 < half < math.inf):
        center, low_text, high_text = ("-" if one is None else _plain(one) for one in span)
        return center, low_text, high_text
    largest = max(abs(one) for one in span if one is not None)
    last = max(_place(half) - INTERVAL_DIGITS + 1, _place(largest) - MAX_DIGITS + 1)
    thousands = 0 if FIXED_RANGE[0] <= largest < FIXED_RANGE[1] else _thousands(largest)
    center, low_text, high_text = ("-" if one is None else _to_place(one, last, thousands) for one in span)
    return center, low_text, high_text


def format_spans(spans: Sequence[Span], unit: str) -> str:
    """Each number with its interval and the unit, log by log where there are several; unit "1" is none."""
    spans, unit = rescaled(spans, unit)
    suffix = "" if unit == "1" else f" {unit.replace('*', ' ')}"
    texts = ["{} ({} to {})".format(*format_span(one)) + suffix for one in spans]
    return ", ".join(f"log {k}: {one}" for k, one in enumerate(texts, start=1)) if len(texts) > 1 else texts[0]


def rescaled(spans: Sequence[Span], unit: str) -> tuple[Sequence[Span], str]:
    """The same in millimetres, micrometres or milliseconds where the largest is small for its unit."""
    largest = max((abs(one) for span in spans for one in span if one is not None), default=0.0)
    for below, factor, smaller in SUBMULTIPLES.get(unit, ()):
        if 0.0 < largest < below:
            return [tuple(None if one is None else factor * one for one in span) for span in spans], smaller  # type: ignore[misc]
    return spans, unit


def _place(number: float) -> int:
    """The decimal place of its first digit: 0 for ones, 1 for tens, -1 for tenths."""
    return math.floor(math.log10(number))


def _thousands(number: float) -> int:
    """The multiple of three by whose power of ten a number is written."""
    return 3 * (_place(number) // 3)


def _plain(number: float) -> str:
    """A number without an interval."""
    if number == 0.0 or not math.isfinite(number) or FIXED_RANGE[0] <= abs(number) < 10.0**PLAIN_DIGITS:
        return f"{number:z.{PLAIN_DIGITS}g}"
    thousands = _thousands(abs(float(f"{number:.{PLAIN_DIGITS}g}")))
    return f"{number / 10.0**thousands:.{PLAIN_DIGITS}g}e{thousands}"


def _to_place(number: float, last: int, thousands: int) -> str:
    """Rounded to a decimal place, and written with the power of ten."""
    if thousands == 0:
        return f"{round(number, -last) + 0.0:.{max(0, -last)}f}"
    if number == 0.0:
        return "0"
    return f"{round(number, -last) / 10.0**thousands + 0.0:.{max(0, thousands - last)}f}e{thousands}"
