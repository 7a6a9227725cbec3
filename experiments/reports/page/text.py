"""Texts on a page: whatever a file, a column or a unit is called, it is shown and neither read nor obeyed."""

import json
import re
from typing import Any

from markupsafe import Markup

from diffdrive.support.messages import printable
from experiments.reports.readable import UNITS, readable, shown

_UNITS = "|".join(map(re.escape, {*UNITS, *UNITS.values()}))
_BEFORE_UNIT = re.compile(rf"(?<=\d) (?=(?:{_UNITS})(?![\w/^]))")


def visible(text: str) -> str:
    """The text with what cannot be seen written out: control characters, changes of direction, broken UTF-8."""
    return readable(printable(text.replace("\t", " ")))


def flowing(text: str) -> str:
    """A sentence in which no line breaks between a number and its unit; one with a command in it stays as it is."""
    text = visible(text)  # first: what reads units there looks for a plain space before them
    return text if "diffdrive " in text or "--" in text else _BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", text)


def finalized(value: object) -> object:
    """What a template puts in for a value; markup that a template made stays, all else is text."""
    if isinstance(value, Markup | int) and not isinstance(value, bool):
        return value
    return visible(value) if isinstance(value, str) else shown(value)


def data_block(value: Any) -> Markup:
    """JSON for a <script> of data: no character in it can end the element, or begin a comment."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for character in "<>&":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return Markup(text)
