"""`diffdrive compare`: what has changed between two sets of logs, with intervals, and a picture of all changes."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from experiments.reports import readable
from experiments.reports.axis_file import write_axis_file
from experiments.reports.checked_logs import axis_with_overrides, parse_loads, read_and_check
from experiments.reports.report import Report, new_figure
from tuning.comparison.change import Change
from tuning.comparison.result import ComparisonResult
from tuning.comparison.workflow import compare_checked, require_level
from tuning.identification.parameters import FIXABLE, parameter_called
from tuning.store.folder import FolderStore

if TYPE_CHECKING:
    from matplotlib.figure import Figure

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
    for finding in result.findings:
        report.say(f"{readable.titled(finding.sentence)}.")
    if not result.findings:
        report.say(f"No change found (p = {readable.significant(result.p_unchanged)}).")
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
    )
    for note in result.notes:
        report.say(f"{readable.titled(note)}.")
    if report.out is None:
        return
    if name := write_axis_file(report, result.axis, "identified.toml"):
        report.keep("written", file=name)
    report.figure("changes", changes_figure(result.changes))


def _row(one: Change) -> list[object]:
    value, between = readable.interval(*(one.factor * number for number in one.change))
    return [
        one.path, readable.unit_of(one.unit), one.before, one.after, f"{value} {one.shown_unit}", between,
        "yes" if one.has_changed else "no",
    ]  # fmt: skip


def changes_figure(changes: Sequence[Change]) -> "Figure":
    """Each change with its interval, over the smallest change that would have been found: beyond 1 it shows."""
    rows = [one for one in reversed(changes) if one.smallest]
    figure, axis = new_figure(1, 1, width=10.0, height=1.2 + 0.3 * len(rows))
    axis.axvspan(-1.0, 1.0, color="0.92", label="changes of this size are often missed")
    axis.axvline(0.0, color="k", lw=0.8)
    for k, one in enumerate(rows):
        value, low, high = (number / (one.smallest or 1.0) for number in one.change)
        colour = "C3" if one.has_changed else "C0"
        axis.errorbar(value, k, xerr=[[value - low], [high - value]], fmt="o", color=colour, capsize=3, ms=5)
        text, between = readable.interval(*(one.factor * number for number in one.change))
        axis.annotate(
            f"{text} ({between}) {one.shown_unit}", (1.01, k), xycoords=("axes fraction", "data"), va="center",
            fontsize=8, color=colour if one.has_changed else "0.4",
        )  # fmt: skip
    # a change of a hundred times what would be seen leaves the others legible
    axis.set_xscale("symlog", linthresh=2.0)
    axis.set(ylim=(-0.6, len(rows) - 0.4), xlabel="change over the smallest that would have been found")
    axis.set_yticks(range(len(rows)), [one.path for one in rows], fontsize=8)
    axis.legend(loc="lower right", fontsize=8)
    return figure
