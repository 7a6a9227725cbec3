"""Factors by which units are mistaken for one another, and their names."""

import math

# how many of the wrong unit make one of the right one
FACTORS = {
    1e3: "thousandfold: milli for unit, such as mm for m",
    1e6: "millionfold: micro for unit, such as um for m",
    1e9: "1e9-fold: nano for unit, such as nm for m",
    100.0: "a hundredfold: centi or per cent",
    1 / 0.0254: "inches for m",
    25.4: "inches and millimetres",
    2 * math.pi: "2 pi: turns and radians",
    180 / math.pi: "degrees and radians",
    360.0: "degrees and turns",
    60.0: "per minute and per second",
    6e4: "mm/min for m/s",
    9.80665: "kilograms and newtons",
}


def unit_error_of(ratio: float) -> str | None:
    """What unit error makes this ratio, to 1 %; either way round; None if none is known."""
    magnitude = abs(ratio)
    if not (0 < magnitude < math.inf):
        return None
    for factor, name in FACTORS.items():
        if abs(magnitude / factor - 1) < 0.01 or abs(magnitude * factor - 1) < 0.01:
            return name
    return None


def unit_error_text(ratio: float) -> str:
    """The name in brackets, for a sentence, or nothing."""
    name = unit_error_of(ratio)
    return f" ({name}?)" if name else ""
