"""The terms of the glossary that a page uses, in the glossary's words."""

import json
import re
from functools import cache
from pathlib import Path
from typing import NamedTuple

FILE = Path(__file__).parent / "assets" / "glossary.json"  # tests/support/glossary.py makes it of the documentation
SHORTEST = 3  # letters of a name that is looked for: single letters stand for too much


class Term(NamedTuple):
    """A term with all its names, as one text; what it means; its unit."""

    term: str
    meaning: str
    unit: str


def terms_in(text: str) -> list[Term]:
    """Those that the text uses, by their names, also in the plural."""
    words = " ".join(text.split()).lower()
    return [term for term, pattern in _terms() if pattern.search(words)]


@cache
def _terms() -> list[tuple[Term, re.Pattern[str]]]:
    terms = [Term(*one) for one in json.loads(FILE.read_text(encoding="utf-8"))]
    return [(term, pattern) for term in terms if (pattern := _pattern(term.term)) is not None]


def _pattern(term: str) -> re.Pattern[str] | None:
    names = [name.strip(" `") for name in re.split(r"[,;]", term)]
    kept = [re.escape(name.lower()) for name in names if len(name) >= SHORTEST]
    return re.compile(rf"(?<![\w-])(?:{'|'.join(kept)})s?(?![\w-])") if kept else None
