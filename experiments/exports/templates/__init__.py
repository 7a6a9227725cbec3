"""The texts that are filled in, by Jinja2."""

import textwrap
import unicodedata
from functools import cache

import jinja2

from experiments.exports.fingerprint import fingerprint_of

WIDTH = 112


def rendered(template: str, **values: object) -> str:
    """A template with these values in it; a name that is missing is an error."""
    return _environment().get_template(template).render(**values)


@cache
def _environment() -> jinja2.Environment:
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("experiments.exports", "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # no template is of a language in which text could run
    )
    environment.filters["comment"] = comment
    environment.filters["quoted"] = quoted
    environment.filters["plain"] = plain
    environment.filters["wrapped"] = wrapped
    environment.filters["fingerprint"] = fingerprint_of
    environment.filters["pin"] = lambda name: name.replace("_", "-")
    return environment


def plain(text: object) -> str:
    """Text in one line of ASCII.

    Editors of controllers read other encodings than UTF-8, and letters that turn the direction would hide code.
    """
    letters = unicodedata.normalize("NFKD", " ".join(str(text).split()))
    return "".join(letter if letter.isascii() and letter.isprintable() else "?" for letter in letters
                   if not unicodedata.combining(letter))  # fmt: skip


def wrapped(text: object) -> str:
    """Text in lines of ASCII, as an item of a list."""
    return textwrap.fill(plain(text), WIDTH, initial_indent="- ", subsequent_indent="  ")


def comment(text: object) -> str:
    """Text that ends no comment of C or of Structured Text, in one line of ASCII."""
    line = plain(text)
    return line.replace("*/", "* /").replace("/*", "/ *").replace("*)", "* )").replace("(*", "( *")[:WIDTH]


def quoted(text: object) -> str:
    """Text that ends no string of C or of a HAL component, in one line."""
    return "".join(letter for letter in comment(text) if letter not in '"\\')
