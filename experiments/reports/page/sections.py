"""The sections of a page, by name: each takes what it needs of a report, or says that there is nothing to show."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from diffdrive.support.registry import Registry
from experiments.reports.page import built_in

if TYPE_CHECKING:
    from experiments.reports.page.page import Page

Take = Callable[["Page"], Mapping[str, Any] | None]
OWN = 45  # the place of a section of one's own: behind figures and tables, before the bare numbers


@dataclass(frozen=True)
class Section:
    """A heading, and a template with what `take` finds in the report; no section where that is None.

    `template` is the text of a Jinja2 template; without one it is the file NAME.html.jinja of the package. `order`
    is its place: the package's are 10, 20 and so on.
    """

    heading: str
    take: Take
    order: int = OWN
    template: str | None = None


SECTIONS: Registry[Section] = Registry(
    "section of a page",
    {
        "result": Section("Result", built_in.result, 10),
        "remarks": Section("Remarks", built_in.remarks, 20),
        "figures": Section("Figures", built_in.figures, 30),
        "tables": Section("Tables", built_in.tables, 40),
        "numbers": Section("Numbers", built_in.numbers, 50),
        "logs": Section("Logs", built_in.logs, 70),
        "files": Section("Files", built_in.files, 80),
        "made": Section("How it was made", built_in.made, 90),
    },
    pattern=r"[a-z][a-z0-9_-]*",
    hint="lower-case letters, digits, - and _, since it is part of a link",
)


def page_section(
    heading: str, template: str | None = None, *, name: str = "", order: int = OWN
) -> Callable[[Take], Take]:
    """Register a section of every page: a function that takes of a page what its `template` shows.

    It returns the names of the template with their values, or None where it has nothing to show. Values are text, never
    markup: the template escapes them.

    Args:
        heading: Of the section, and its line in the contents.
        template: A text in the language of Jinja2; by default the package's file NAME.html.jinja.
        name: By which it is known, and linked; the name of the function unless given.
        order: Its place: the result has 10, remarks 20, figures 30, tables 40, numbers 50, the log files 70.

    Raises:
        ParameterError: The package has a section of that name.

    Examples:
        >>> @page_section("Wear", "<p>{{ hours }} h of service</p>")
        ... def wear(page):
        ...     return {"hours": page.data["run"]["hours"]} if "run" in page.data else None

    """

    def registered(take: Take) -> Take:
        SECTIONS.add(name or take.__name__, Section(heading, take, order, template))
        return take

    return registered
