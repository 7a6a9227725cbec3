"""What a report gathers for its page, beside what result.json holds: nothing here is drawn or written yet."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from experiments.reports.page.chart import Chart
from experiments.reports.readable import INFINITE

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class ShownTable:
    """A table as it was printed; `of` is the recorded table (and CSV file) that has the same content, if any."""

    caption: str
    columns: Sequence[str]
    rows: Sequence[Sequence[object]]
    digits: int
    notes: Sequence[str] = ()
    of: str = ""
    infinite: str = INFINITE


@dataclass(frozen=True)
class Picture:
    """A figure that was saved: its file, and in words what it is and what its axes show."""

    name: str
    file: str
    caption: str
    description: str


@dataclass
class Contents:
    """What stands on a page: conclusions first, then tables, pictures, charts, and what single sections are given."""

    conclusions: list[str] = field(default_factory=list)
    good: bool | None = None  # whether the result is; None: that is not judged
    verdict: str = ""  # in a word
    tables: list[ShownTable] = field(default_factory=list)
    pictures: list[Picture] = field(default_factory=list)
    charts: dict[str, Chart] = field(default_factory=dict)
    given: dict[str, Any] = field(default_factory=dict)  # to sections of single commands, by a name that they know
    covered: set[str] = field(default_factory=set)  # sections that those stand for
    is_command: bool = True  # whether the arguments of the process are those of the report
    logs: list[Mapping[str, object]] = field(default_factory=list)  # what was read, a row each


def described(caption: str, figure: "Figure") -> str:
    """A figure in words, of what its axes say: for who cannot see it."""
    said = [caption.rstrip(".")]
    for axes in figure.axes:
        lines = [label for label in axes.get_legend_handles_labels()[1] if not label.startswith("_")]
        title, x, y = axes.get_title(), axes.get_xlabel(), axes.get_ylabel()
        over = " over ".join(one for one in (y, x) if one)
        said.append(": ".join(one for one in (title, over, "; ".join(lines)) if one))
    return ". ".join(one for one in said if one) + "."
