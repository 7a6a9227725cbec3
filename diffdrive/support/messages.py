"""User input in messages: on one line, of bounded length, and without control characters."""

import difflib
import re
import reprlib
import unicodedata
from collections.abc import Collection

MAX_LISTED = 30  # names; of more, those nearest to the wanted one are listed
NEAREST = 5
MAX_LENGTH = 60  # characters of one name or value

_REPR = reprlib.Repr()  # which takes no arguments before Python 3.12
_REPR.maxlevel, _REPR.maxlist, _REPR.maxdict = 3, 6, 4
_REPR.maxstring, _REPR.maxlong, _REPR.maxother = MAX_LENGTH, 40, MAX_LENGTH


def printable(text: str) -> str:
    """The text with its control characters written out: colours, cursor moves, line ends, changes of direction.

    A message that quotes a file must stay one line, and the file must not draw on the terminal. Tabs stay.
    """
    if text.isprintable():
        return text
    return "".join(
        character if character.isprintable() or not _is_control(character) else _escaped(character)
        for character in text
    )


def _is_control(character: str) -> bool:
    return character != "\t" and unicodedata.category(character) in ("Cc", "Cf", "Cs", "Zl", "Zp")


def _escaped(character: str) -> str:
    return character.encode("unicode_escape").decode()


def short_repr(value: object) -> str:
    """`repr` of a value, shortened: nested lists, and a number of 400 digits, are cut in the middle."""
    return shortened(_REPR.repr(value), 2 * MAX_LENGTH)


def shortened(text: str, longest: int = MAX_LENGTH) -> str:
    """A text with its middle left out where it is long."""
    return text if len(text) <= longest else f"{text[: longest - 20]}...{text[-17:]}"


def suggestion(name: str, known: Collection[str]) -> str:
    """Which of the `known` names may have been meant, or all of them."""
    near = difflib.get_close_matches(name, known, n=1)
    return f"did you mean '{near[0]}'?" if near else f"known: {', '.join(known)}"


def quoted_names(names: Collection[str], wanted: str = "", noun: str = "names") -> str:
    """Names in quotes: all if they are few, else their number and those near `wanted`."""
    if len(names) <= MAX_LISTED:
        return ", ".join(f"'{shortened(name)}'" for name in names)
    near = difflib.get_close_matches(wanted, names, n=NEAREST)
    if near:
        return f"{len(names)} {noun}; near '{shortened(wanted)}' are {quoted_names(near)}"
    first = [name for name, _ in zip(names, range(2 * NEAREST), strict=False)]
    return f"{len(names)} {noun}, {quoted_names(first)} and {len(names) - len(first)} more"


def option_text(name: str, value: str) -> str:
    """A command-line option with its value, in quotes where a shell needs them."""
    return f"--{name} {value}" if re.fullmatch(r"[\w.=/-]+", value) else f'--{name} "{value}"'
