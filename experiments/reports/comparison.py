"""`diffdrive compare`: what has changed between two sets of logs, with intervals, and a picture of all changes."""

from collections.abc import Sequence
from math import ceil, log10
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.reports import readable
from experiments.reports.axis_file import write_axis_file
from experiments.reports.charts.missing_force import of_comparison
from experiments.reports.checked_logs import axis_with_overrides, parse_loads, read_and_check
from experiments.reports.report import Report
from experiments.reports.theme import (
    BLACK,
    BLUE,
    GREY,
    PALE,
    REFERENCE,
    SMALL,
    VERMILION,
    drawing,
    legend_below,
    new_figure,
    say,
)
from tuning.comparison.change import Change
from tuning.comparison.result import ComparisonResult
from tuning.comparison.workflow import compare_checked, require_level
from tuning.identification.modelled_friction import gap_free_pieces
from tuning.identification.parameters import FIXABLE, parameter_called
from tuning.identification.workflow import IdentificationResult
from tuning.store.folder import FolderStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BY_ITSELF = (
    "Before and after are each identified by itself. A change is estimated with what has not changed the same on both "
    "sides, which is known better, so it need not be the difference of the two."
)
LONG = 1e3  # numbers from which on are written with an exponent: beside their neighbours there is room for no more
FEW_DECADES = 2  # of changes, over the smallest that would have been found
PARTS = "comparison.parts"  # finished searches, from which the same command continues


def compare_logs(
    before: Sequence[Path],
    after: Sequence[Path],
    drive: Path,
    out: Path | None,
    *,
    columns: Sequence[str] = (),
    units: Sequence[str] = (),
    shifts: Sequence[str] = (),
    fixed: Sequence[str] = (),
    loads: Sequence[str] = (),
    level: float,
    starts: int = 6,
    seed: int = 0,
    force: bool = False,
) -> bool:
    """`diffdrive compare`; False if the result is doubtful.

    `columns`, `units`, `shifts`, `fixed`, `loads` are texts as on the command line. Raises `DriveFileError`, `LogError`
    and `ParameterError`, one line each.
    """
    require_level(level)
    paths = [*before, *after]
    axis = axis_with_overrides(drive, columns, units, shifts, paths)
    for name in fixed:
        parameter_called(name, FIXABLE, f"--fixed {name}: no such parameter")
    applied = parse_loads(loads, paths, axis.sheet)
    title = f"{drive.name}: {', '.join(path.name for path in after)} against {', '.join(path.name for path in before)}"
    with Report(title, out) as report:
        sides = [
            read_and_check(side, axis, report, name=name, loads=applied, used=("motor_position",))
            for side, name in ((before, "findings_before"), (after, "findings_after"))
        ]
        parts = FolderStore.in_folder(out, PARTS)
        with report.stages() as progress:  # half of it is no comparison: an interrupt ends it, and the parts stay
            result = compare_checked(
                axis, *sides, fixed=fixed, level=level, starts=starts, seed=seed, force=force, store=parts,
                progress=progress,
            )  # fmt: skip
        report_comparison_of_logs(report, result)
        if out is not None:
            result.save(out)
        if parts is not None:  # while no other run may write here
            parts.remove()
    return result.status.ok


def report_comparison_of_logs(report: Report, result: ComparisonResult) -> None:
    """The findings, the table of all that was compared, the figure, and the axis as it is after."""
    report.keep(
        "comparison", status=result.status.message, code=result.status.code, p_unchanged=result.p_unchanged,
        level=result.level,
    )  # fmt: skip
    found = [f"{readable.titled(finding.sentence)}." for finding in result.findings]
    found = found or [f"No change found (p = {readable.significant(result.p_unchanged)})."]
    report.conclude(*found, good=None if result.status.ok else False)
    for sentence in found:
        report.say(sentence)
    names = ("compared", "unit", "before", "after", "change", "at least", "at most", "unit of change", "changed")
    rows = [
        [
            one.path, readable.unit_of(one.unit), one.before, one.after,
            *(one.factor * value for value in one.change), one.shown_unit, "yes" if one.has_changed else "no",
        ]
        for one in result.changes
    ]  # fmt: skip
    report.record("changes", names, rows)
    report.show(
        "Before and after, with the 95 % interval of the change",
        ("compared", "unit", "before", "after", "change", "95 % interval", "changed"),
        [_row(one) for one in result.changes],
        notes=[BY_ITSELF],
        of="changes",
    )
    for note in result.notes:
        report.say(f"{readable.titled(note)}.")
    if report.out is None:
        return
    if name := write_axis_file(report, result.axis, "identified.toml"):
        report.keep("written", file=name)
    sides = {"before": result.before, "after": result.after}
    logs = " against ".join(_names(sides[name]) for name in ("after", "before"))
    report.figure("changes", changes_figure(result.changes), (
        f"Each change over the smallest that would have been found, with its 95 % interval: {logs}."
    ))  # fmt: skip
    fits = {name: (one.fit, gap_free_pieces(one.logs.logs)) for name, one in sides.items()}
    report.chart("missing_force", of_comparison(fits))


def _names(side: IdentificationResult) -> str:
    return ", ".join(log.name for log in side.logs.logs)


def _row(one: Change) -> list[object]:
    value, between = readable.interval(*(one.factor * number for number in one.change))
    return [
        one.path, readable.unit_of(one.unit), one.before, one.after, f"{value} {one.shown_unit}", between,
        "yes" if one.has_changed else "no",
    ]  # fmt: skip


def _called(one: Change) -> str:
    return f"{one.label.removeprefix('the ')} {one.direction}".strip()


@drawing
def changes_figure(changes: Sequence[Change]) -> "Figure":
    """Each change with its interval, over the smallest change that would have been found: beyond 1 it shows."""
    rows = [one for one in reversed(changes) if one.smallest]
    figure, axis = new_figure(height=1.5 + 0.27 * len(rows))
    axis.axvspan(-1.0, 1.0, color=PALE, lw=0, label="changes of this size are often missed")
    axis.axvline(0.0, **REFERENCE)
    named: set[bool] = set()
    for k, one in enumerate(rows):
        value, low, high = (number / (one.smallest or 1.0) for number in one.change)
        look = {"color": VERMILION, "fmt": "s"} if one.has_changed else {"color": BLUE, "fmt": "o"}
        label = None if one.has_changed in named else "changed" if one.has_changed else "no change found"
        named.add(one.has_changed)
        axis.errorbar(value, k, xerr=[[value - low], [high - value]], capsize=3, ms=5, label=label, **look)
        text, between = readable.interval(*(one.factor * number for number in one.change))
        unit = "" if one.shown_unit == "1" else f" {readable.readable(one.shown_unit)}"
        axis.annotate(
            f"{text} ({between}){unit}", (1.01, k), va="center",
            xycoords=("axes fraction", "data"), fontsize=SMALL, color=BLACK if one.has_changed else GREY,
        )  # fmt: skip
    # a change of a hundred times what would be seen leaves the others legible
    axis.set_xscale("symlog", linthresh=2.0)
    most = max(abs(number) / (one.smallest or 1.0) for one in rows for number in one.change) if rows else 1.0
    decades = ceil(log10(max(most, 2.0)))
    digits = (5.0, 10.0) if decades <= FEW_DECADES else (10.0,)  # numbers would hide each other
    marks = [1.0, 2.0, *(digit * 10.0**k for k in range(decades) for digit in digits)]
    ticks = sorted({0.0, *marks, *(-mark for mark in marks)})
    left, right = axis.get_xlim()
    axis.set_xticks(ticks, [f"{tick:g}" if abs(tick) < LONG else f"{tick:.0e}".replace("e+0", "e") for tick in ticks])
    axis.set_xlim(left, right)
    axis.set(ylim=(-0.6, len(rows) - 0.4), xlabel="change over the smallest that would have been found (ratio)")
    axis.set_yticks(range(len(rows)), [_called(one) for one in rows])
    legend_below(figure)
    changed = [one for one in rows if one.has_changed]
    first = max(changed, key=lambda one: abs(one.change[0]) / (one.smallest or 1.0), default=None)
    finding = f"{len(changed)} of {len(rows)} quantities have changed"
    if first is not None:
        text, _ = readable.interval(*(first.factor * number for number in first.change))
        finding += f", most clearly the {_called(first)}: {text} {readable.readable(first.shown_unit)}"
    say(figure, finding)
    return figure
