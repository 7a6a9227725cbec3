"""Renders a report as one self-contained HTML page: nothing is loaded, and nothing runs but the page's own scripts."""

import base64
import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from experiments.reports.page.contents import Contents
from experiments.reports.page.glossary import terms_in
from experiments.reports.page.sections import SECTIONS, Section
from experiments.reports.page.text import finalized, flowing

HERE = Path(__file__).parent
PLOTLY = "plotly-basic-4.1.1.min.js"
# styles cannot run; plotly.js makes some as it draws
POLICY = (
    "default-src 'none'; script-src {scripts}; style-src 'unsafe-inline'; img-src data:; base-uri 'none'; "
    "form-action 'none'"
)


@dataclass
class Page:
    """What sections take from: the report's `data` (all that result.json holds), its `contents`, and its folder."""

    data: Mapping[str, Any]
    contents: Contents
    folder: Path
    name: str  # of the page's file
    began: float  # when the command did, in s since 1970
    shown: set[str] = field(default_factory=set)  # figures and tables that a section has shown
    pictured: int = 0  # bytes of the pictures that stand on it


@dataclass(frozen=True)
class Part:
    """A section as it stands on the page."""

    name: str
    heading: str
    body: Markup


def render(page: Page) -> str:
    """The page, as text."""
    parts = [part for name, section in _in_order() if (part := _part(page, name, section)) is not None]
    said = [part.body for part in parts if part.name not in ("files", "made")]  # names of files are no terms
    terms = terms_in(re.sub(r"<script.*?</script>|<[^>]*>", " ", " ".join(said), flags=re.S))
    if terms:
        body = _environment().get_template("terms.html.jinja").render(terms=terms)
        parts.append(Part("terms", "Terms", Markup(body)))
    scripts = [_asset("page.js"), *([_asset(PLOTLY)] if page.contents.charts else [])]
    policy = POLICY.format(scripts=" ".join(f"'sha256-{_digest(one)}'" for one in scripts))
    return _environment().get_template("page.html.jinja").render(
        title=page.data["title"], date=page.data["made_by"]["date"], policy=Markup(policy), parts=parts,
        style=Markup(_asset("page.css")), script=Markup(scripts[0]),
        plotly=Markup(scripts[1]) if len(scripts) > 1 else None,
    )  # fmt: skip


def _in_order() -> list[tuple[str, Section]]:
    return sorted(SECTIONS.items(), key=lambda item: item[1].order)


def _part(page: Page, name: str, section: Section) -> Part | None:
    taken = None if name in page.contents.covered else section.take(page)
    if taken is None:
        return None
    environment = _environment()
    if section.template is None:
        template = environment.get_template(f"{name}.html.jinja")
    else:
        template = environment.from_string(section.template)
    return Part(name, section.heading, Markup(template.render(taken)))


@cache
def _environment() -> Environment:
    """Every value that a template puts in is escaped, and one that is missing is an error."""
    made = Environment(
        loader=FileSystemLoader(HERE / "templates"), autoescape=True, undefined=StrictUndefined, finalize=finalized,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    made.filters["flowing"] = flowing
    return made


@cache
def _asset(name: str) -> str:
    return (HERE / "assets" / name).read_text(encoding="utf-8")


@cache
def _digest(script: str) -> str:
    """By which the page's policy knows a script of its own."""
    return base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii")
