"""What is printed, as a person reads it: few digits, a unit in every heading, and tables as wide as the terminal."""

import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal

import numpy as np

from diffdrive.support.messages import printable
from diffdrive.support.spans import format_span

DIGITS = 4
INFINITE = "infinite"
LEAST_PLAIN = -3  # power of ten below which a number is written with its exponent
LARGEST_WHOLE = 1e6  # up to which a whole number is written out
GAP = "  "  # between columns
UNITS = {
    "um": "µm", "nm": "nm", "mm": "mm", "m": "m", "m/s": "m/s", "mm/s": "mm/s", "m/s^2": "m/s²", "s": "s", "ms": "ms",
    "us": "µs", "ns": "ns", "1/s": "1/s", "Hz": "Hz", "kHz": "kHz", "N": "N", "kN": "kN",
    "N/m": "N/m", "N*s/m": "N s/m", "kg": "kg", "mA": "mA", "V": "V", "dB": "dB", "deg": "°", "%": "%", "percent": "%",
    "MB": "MB",
}  # fmt: skip
KEYS = {"Ns_per_m": "N s/m", "N_per_m": "N/m", "m_per_s": "m/s", "mm_per_s": "mm/s", "per_s": "1/s"}  # as keys end
SHORT = ("m", "s", "V")  # units that are a unit only at the end of a heading
WORDS = {"+-": "±", "rms": "RMS"}
MICROMETRE = re.compile(r"(?<![\w.:=,+-])(?:(?<=[\d)] )|(?<=\()|(?<=, )|(?<=[a-z] )|(?<=1/)|^)um\b(?!=)")


def readable(text: str) -> str:
    """Prose with its micrometres as people write them; what could be copied to a command line stays as it is."""
    return MICROMETRE.sub("µm", text)


def significant(value: float, digits: int = DIGITS) -> str:
    """So many significant digits; very large and very small numbers with an exponent that is a multiple of three."""
    if not math.isfinite(value):
        return "-" if math.isnan(value) else INFINITE if value > 0.0 else f"-{INFINITE}"
    if value == 0.0:
        return "0"
    if value == round(value) and abs(value) < LARGEST_WHOLE:
        return f"{value:.0f}"
    exponent = int(f"{value:.{digits - 1}e}".partition("e")[2])  # after rounding: 9999.9 has that of 10000
    if LEAST_PLAIN <= exponent < digits:
        return _stripped(f"{value:.{digits - 1 - exponent}f}")
    thousands = 3 * (exponent // 3)
    return (
        _stripped(f"{Decimal(value).scaleb(-thousands):.{max(0, digits - 1 - exponent + thousands)}f}")
        + f"e{thousands}"
    )


def interval(value: float, low: float, high: float) -> tuple[str, str]:
    """A number and its interval, all to the same place, so that the interval shows."""
    largest = max(abs(value), abs(low), abs(high))
    thousands = 0
    if math.isfinite(largest) and largest > 0.0 and not 10.0**LEAST_PLAIN <= largest < LARGEST_WHOLE:
        thousands = 3 * math.floor(math.log10(largest) / 3)
    ending = f"e{thousands}" if thousands else ""
    scaled = value / 10.0**thousands, low / 10.0**thousands, high / 10.0**thousands
    texts = [f"{text}{ending}" for text in format_span(scaled)]
    if math.isfinite(low) and math.isfinite(high):
        return texts[0], f"{texts[1]} to {texts[2]}"
    if math.isfinite(low) or math.isfinite(high):
        return texts[0], f"at least {texts[1]}" if math.isfinite(low) else f"at most {texts[2]}"
    return texts[0], "without limits"


def _stripped(text: str) -> str:
    return text.rstrip("0").rstrip(".") if "." in text else text


def shown(value: object, digits: int = DIGITS, infinite: str = INFINITE) -> str:
    """A value as a cell of a table; `infinite` is what a number without a limit means there."""
    if value is None:
        return "-"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating):
        return infinite if value == math.inf else significant(float(value), digits)
    if isinstance(value, list | tuple):
        return ", ".join(shown(one, digits, infinite) for one in value) or "-"
    return readable(printable(str(value)))


def heading(name: str) -> tuple[str, str]:
    """The words and the unit, which may be empty, of a column or of a named number: `RMS um`, `peak_error_um`."""
    words, comma, unit = name.rpartition(", ")
    if comma and unit in UNITS:
        return _words(words), UNITS[unit]
    if " " not in name:
        return _of_key(name)
    tokens = name.split(" ")
    for k, token in enumerate(tokens):
        ends = k == len(tokens) - 1
        if token in UNITS and (ends or token not in SHORT) and not (k and tokens[k - 1][-1:].isdigit()):
            return _words(" ".join(tokens[:k] + tokens[k + 1 :])), UNITS[token]
    return _words(name), ""


def _of_key(key: str) -> tuple[str, str]:
    for ending, unit in (KEYS | UNITS).items():
        if key == ending:
            return "", unit
        if key.endswith(f"_{ending}"):
            return _words(key.removesuffix(f"_{ending}")), unit
    return _words(key), ""


def _words(text: str) -> str:
    """Keys as words: underscores are for programs, but a name with a dot is one that a file has."""
    text = text if "." in text else text.replace("_", " ")
    return readable(printable(" ".join(WORDS.get(word, word) for word in text.split(" "))))


def unit_of(unit: str) -> str:
    """A unit as a cell of a table."""
    return "-" if unit == "1" else unit.replace("*", " ")


def titled(text: str) -> str:
    """With a capital at its beginning, unless its first word is a name or a symbol."""
    return text[:1].upper() + text[1:] if re.match(r"[a-z]+\b(?!\.)", text) else text


def numbers(name: str, values: Mapping[str, object], width: int) -> list[str]:
    """Named numbers: in one line where they fit, else one line each."""
    title, pairs = titled(_words(name)), []
    for key, value in values.items():
        words, unit = heading(key)
        number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
        text = shown(value)
        pairs.append((words, f"{text} {unit}" if unit and number else text))
    line = f"{title}: " + ", ".join(f"{words} {text}".strip() for words, text in pairs)
    if len(line) <= width:
        return [line]
    longest = max(len(words) for words, _ in pairs)
    lines = [wrapped(f"  {words:<{longest}}  {text}", width, indent=longest + 4) for words, text in pairs]
    return [title, *(line for part in lines for line in part)]


def wrapped(text: str, width: int, indent: int = 0) -> list[str]:
    """Lines no wider than that, broken between words only; a line's own indent is kept."""
    lines = []
    for line in text.splitlines() or [""]:
        own = len(line) - len(line.lstrip(" "))
        after = " " * (indent or own + 2 * line.lstrip().startswith("- "))
        lines += textwrap.wrap(
            line, width, subsequent_indent=after, break_long_words=False, break_on_hyphens=False,
            drop_whitespace=True, replace_whitespace=False,
        ) or [""]  # fmt: skip
    return lines


@dataclass
class Column:
    """A heading in words, its unit, and the cells below it, in which infinity is a word."""

    words: str
    unit: str
    cells: list[str]
    infinite: str = INFINITE
    width: int = 0

    @property
    def numeric(self) -> bool:
        """Whether it is read from the right."""
        kept = [cell for cell in self.cells if cell.removeprefix("-") not in ("", self.infinite)]
        return all(re.match(r"[-+]?[\d.]", cell) for cell in kept)

    @property
    def natural(self) -> int:
        """So wide that no cell is broken, and the heading only between words."""
        return max(_longest_word(self.words), len(self.unit), *map(len, self.cells), 1)

    @property
    def least(self) -> int:
        """So wide that no word is broken, and no number from its interval."""
        return (
            self.natural
            if self.numeric
            else max(_longest_word(self.words), len(self.unit), *map(_longest_word, self.cells), 1)
        )

    def lines(self, text: str) -> list[str]:
        """A text within the width."""
        aligned = str.rjust if self.numeric else str.ljust
        return [aligned(line, self.width) for line in wrapped(text, self.width)]


def _longest_word(text: str) -> int:
    return max(map(len, text.split(" ")), default=0)


def table(
    headings: Sequence[str],
    rows: Sequence[Sequence[object]],
    width: int,
    digits: int = DIGITS,
    infinite: str = INFINITE,
) -> list[list[str]]:
    """Lines of a table; of several, one beside the other in their columns, where one would be wider than that.

    Each of several begins with the columns that tell the rows apart. The first lines of each are its headings, down to
    the rule.
    """
    columns = []
    for k, name in enumerate(headings):
        columns.append(Column(*heading(name), [shown(row[k], digits, infinite) for row in rows], infinite))
    return [_drawn(block) for block in _blocks(columns, width)]


def _blocks(columns: list[Column], width: int) -> list[list[Column]]:
    """Columns that fit together, their widths set."""
    if not columns or _fit(columns, width):
        return [columns]
    keys = _keys(columns)
    while len(keys) > 1 and any(_needed([*keys, other], "least") > width for other in columns[len(keys) :]):
        keys = keys[:-1]  # rows that look alike are better than lines that the terminal breaks
    blocks: list[list[Column]] = []
    rest = columns[len(keys) :]
    while rest:
        count = max((k for k in range(1, len(rest) + 1) if _needed([*keys, *rest[:k]], "natural") <= width), default=1)
        block = [*(replace(one) for one in keys), *rest[:count]]
        _fit(block, width)
        blocks.append(block)
        rest = rest[count:]
    return blocks


def _keys(columns: list[Column]) -> list[Column]:
    """The first columns, as many as tell the rows apart; never all."""
    for k in range(1, len(columns)):
        rows = list(zip(*(one.cells for one in columns[:k]), strict=True))
        if len(set(rows)) == len(rows):
            return columns[:k]
    return columns[:1]


def _needed(columns: Sequence[Column], which: str) -> int:
    return sum(getattr(one, which) for one in columns) + len(GAP) * (len(columns) - 1)


def _fit(columns: list[Column], width: int) -> bool:
    """Set the widths; whether they fit without breaking a word."""
    for one in columns:
        one.width = one.natural
    room = width - _needed(columns, "width")
    for one in columns:  # headings in one line, as far as there is room
        more = min(len(one.words) - one.width, room)
        if more == len(one.words) - one.width > 0:
            one.width += more
            room -= more
    while room < 0:
        wide = [one for one in columns if one.width > one.least]
        if not wide:
            return False
        max(wide, key=lambda one: one.width).width -= 1
        room += 1
    return True


def _drawn(columns: Sequence[Column]) -> list[str]:
    heads = [one.lines(one.words) if one.words else [] for one in columns]
    most = max((len(head) for head in heads), default=0)
    lines = [
        _line(columns, [([""] * (most - len(head)) + head)[k] for head in heads]) for k in range(most)
    ]  # the last lines of the headings stand beside each other
    if any(one.unit for one in columns):
        lines.append(_line(columns, [one.unit for one in columns]))
    lines.append(GAP.join("─" * one.width for one in columns))
    for row in zip(*(one.cells for one in columns), strict=True):
        cells = [one.lines(cell) for one, cell in zip(columns, row, strict=True)]
        for k in range(max(map(len, cells), default=0)):
            lines.append(_line(columns, [cell[k] if k < len(cell) else "" for cell in cells]))
    return lines


def _line(columns: Sequence[Column], texts: Sequence[str]) -> str:
    aligned = [(text.rjust if one.numeric else text.ljust)(one.width) for one, text in zip(columns, texts, strict=True)]
    return GAP.join(aligned).rstrip()


def in_ascii(text: str) -> str:
    """For a terminal that has no other characters."""
    return text.replace("µ", "u").replace("±", "+-").replace("─", "-").replace("°", "deg").replace("²", "^2")
