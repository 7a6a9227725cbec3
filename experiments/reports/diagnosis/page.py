"""The sections of a diagnosis's page: the four questions, what else the logs would show, and what next."""

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from experiments.reports.diagnosis import payoff
from experiments.reports.diagnosis.answers import (
    BOTH,
    CAUSES,
    FOUND_FIRST,
    LADDER,
    LIMIT,
    LIMITS,
    LOOP,
    NOMINAL,
    NOT_SEARCHED,
    NOT_WORTH,
    NOWHERE,
    SHRINK,
    SIZE,
    Details,
    Row,
    cause_row,
    ladder_rows,
    limit_row,
    loop_reasons,
    odd_notes,
    recalibrated_row,
    regions_in_words,
    size_rows,
)  # fmt: skip
from experiments.reports.page.built_in import shown_figures
from experiments.reports.page.sections import page_section
from experiments.reports.page.table import PageTable, page_table
from experiments.reports.report import Report
from tuning.diagnosis.cause_words import headlines

if TYPE_CHECKING:
    from experiments.reports.page.page import Page

GIVEN = "diagnosis"
COVERED = ("numbers", "tables", "remarks")  # sections that these stand for
Taken = Mapping[str, Any] | None


def give_page(report: Report, details: Details, augmented: str | None) -> None:
    """Give the page what diagnosis.json holds, and the name of the drive file with what was found."""
    report.page.conclusions = []  # given twice, where the payoff is added to what was found
    report.conclude(details["says"], *headlines(details["causes"]), verdict=details["verdict"])
    report.page.given[GIVEN] = (details, augmented)
    report.page.covered |= set(COVERED)


def _details(page: "Page") -> Details | None:
    return page.contents.given[GIVEN][0] if GIVEN in page.contents.given else None


@page_section("1. How large is the gap?", order=20)
def gap(page: "Page") -> Taken:
    """The size of the gap before anything is added, and before it what the checks of the logs found."""
    if (details := _details(page)) is None:
        return None
    size = details["gap"]
    return {
        "findings": _findings(details), "says": size["says"], "notes": odd_notes(details["ladder"][:2]),
        "table": _table(SIZE, size_rows(details), f"{LOOP}; {size['judged_on']}", page, "gap"),
        "figures": shown_figures(page, {"missing_force"}),
    }  # fmt: skip


@page_section("2. Where does it lie?", order=21)
def where(page: "Page") -> Taken:
    """The regions with more of the gap than chance would give."""
    if (details := _details(page)) is None:
        return None
    return {
        "regions": regions_in_words(details),
        "nowhere": NOWHERE,
        "figures": shown_figures(page, {"where"}),
    }


@page_section("3. Which unmodelled effect causes it?", order=22)
def causes(page: "Page") -> Taken:
    """The causes, what is left, and the nominal parameters."""
    if (details := _details(page)) is None:
        return None
    rows = [cause_row(one) for one in details["causes"]]
    return {
        "table": _table(CAUSES, rows, FOUND_FIRST, page, "causes") if rows else None,
        "why_none": NOT_WORTH if details["searched"] else NOT_SEARCHED, "left": details["left_looks_like"],
        "figures": shown_figures(page, {"causes"}),
        "nominal": page_table(BOTH, NOMINAL, [recalibrated_row(one) for one in details["recalibrated"]]),
    }  # fmt: skip


@page_section("4. How far does the gap shrink once it is added?", order=23)
def shrink(page: "Page") -> Taken:
    """The ladder of models on held-out data, and what the controller gains."""
    if (details := _details(page)) is None:
        return None
    judged_on = details["gap"]["judged_on"]
    return {
        "says": details["closed"]["says"], "notes": odd_notes(details["ladder"]), "loop": loop_reasons(details),
        "table": _table(LADDER, ladder_rows(details), f"{SHRINK}; {judged_on}", page, "ladder"),
        "figures": shown_figures(page, {"ladder"}), "augmented": page.contents.given[GIVEN][1],
        "scale_noise": details["scale_noise"], "payoff": _payoff(details),
    }  # fmt: skip


@page_section("What else would these logs show?", name="limits", order=24)
def detection_limits(page: "Page") -> Taken:
    """Effects that were not found, and the size from which on they would have been."""
    details = _details(page)
    if details is None or not details["detection_limits"]:
        return None
    rows = [limit_row(one) for one in details["detection_limits"]]
    alike = [one["says"] for one in details["hardly_told_apart"]]
    return {"table": _table(LIMITS, rows, LIMIT, page, "detection_limits"), "alike": alike}


@page_section("What next?", name="next", order=25)
def next_motion(page: "Page") -> Taken:
    """The motion that would decide."""
    details = _details(page)
    return None if details is None else {"says": details["next_experiment"]["says"]}


def _table(columns: tuple[str, ...], rows: list[Row], caption: str, page: "Page", name: str) -> PageTable:
    """With a link to its CSV file, where that was written by now."""
    return page_table(caption, columns, rows, file=f"./{name}.csv" if name in page.data.get("tables", {}) else "")


def _findings(details: Details) -> PageTable | None:
    keys = ("log", "severity", "channel", "found", "mend")
    rows = [[one[key] for key in keys] for one in details["findings"]]
    return page_table("Before all: the log checks", (*keys[:-1], "remedy"), rows) if rows else None


def _payoff(details: Details) -> dict[str, object] | None:
    """What the controller gains by being tuned on what was found."""
    if (paid := details.get("payoff")) is None:
        return None
    rows = [
        [name, *(one[key] for key in payoff.COLUMNS), one["requirements_kept_where_tuned"]]
        for name, one in paid["gains"].items()
    ]
    columns = ("gains", *payoff.COLUMNS, "requirements kept where tuned")
    return {"says": paid["says"], "table": page_table(payoff.CAPTION, columns, rows) if rows else None}
