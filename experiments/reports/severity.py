"""`diffdrive severity`: the accuracy of an axis with and without each of its effects, and a picture of it."""

from typing import TYPE_CHECKING

import numpy as np

from experiments.reports import readable
from experiments.reports.charts.circle import circle_chart
from experiments.reports.report import Report
from experiments.reports.theme import BLUE, DASHES, REFERENCE, drawing, legend_below, new_figure, say
from tuning.accuracy.result import AS_IT_IS, SOUND, TERMS, SeverityResult, Without

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GIVEN, MENDED = "as it is", "sound"


def report_severity(report: Report, found: SeverityResult) -> None:
    """What to mend first, the table of all machines, the figure, and `severity.json`."""
    unit, factor = found.unit
    report.keep("severity", first=None if found.first is None else found.first.effect, beyond=list(found.beyond))
    lines = [readable.titled(line.removeprefix("- ")) for line in found.summary().splitlines()]
    report.conclude(*lines, good=not found.beyond)
    for line in lines:
        report.say(line)
    kept = [name for name in TERMS if getattr(found.as_it_is, name) is not None]
    rows = [
        [machine, *(factor * getattr(accuracy, name) for name in kept)]
        for machine, accuracy in ((GIVEN, found.as_it_is), *((_named(one), one.accuracy) for one in found.without))
    ]
    symbols = [f"{TERMS[name].rpartition(' ')[2]} {unit.replace('µ', 'u')}" for name in kept]
    notes = [", ".join(f"{TERMS[name].rpartition(' ')[2]}: {TERMS[name].rpartition(' ')[0]}" for name in kept) + "."]
    report.table("severity", ("machine", *symbols), rows, "ISO 230-2 and 230-4, simulated", notes=notes)
    if report.out is not None:
        found.save(report.out)
        report.figure("severity", severity_figure(found), (
            "Simulated accuracy of the drive as it is, without each effect of its drive file, and without all of them."
        ))  # fmt: skip
        if found.circles:
            in_order = {_named(one): found.circles[one.effect] for one in [*found.by_gain, found.without[-1]]}
            report.chart("circle", circle_chart({GIVEN: found.circles[AS_IT_IS]} | in_order))


def _named(one: Without) -> str:
    return MENDED if one.effect == SOUND else f"without {one.effect}"


@drawing
def severity_figure(found: SeverityResult) -> "Figure":
    """Bars of accuracy A and, in a panel of its own, of circular deviation G: of each machine; the tolerance."""
    unit, factor = found.unit
    machines = [(GIVEN, found.as_it_is)]
    machines += [(_named(one), one.accuracy) for one in [*found.by_gain, found.without[-1]]]
    judged = list(found.as_it_is.judged())
    figure, axes = new_figure(1, len(judged), height=1.5 + 0.3 * len(machines), share_x=False, share_y=True)
    for axis, name in zip(np.atleast_1d(axes), judged, strict=True):
        values = [factor * one.judged()[name] for _, one in machines]
        bars = axis.barh(range(len(machines)), values, 0.6, color=BLUE)
        axis.bar_label(bars, [readable.shown(value, 3) for value in values], padding=3)
        if found.tolerance is not None:
            label = f"tolerance {factor * found.tolerance:.3g} {unit}"
            axis.axvline(factor * found.tolerance, ls=DASHES[1], label=label, **REFERENCE)
        axis.margins(x=0.2)
        axis.set_xlabel(f"{TERMS[name]}, {unit}")
    first = np.atleast_1d(axes)[0]
    first.set_yticks(range(len(machines)), [name for name, _ in machines])
    first.invert_yaxis()
    if found.tolerance is not None:
        legend_below(figure)
    parts = []
    for name in judged:
        parts.append(f"{TERMS[name]} {readable.shown(factor * found.as_it_is.judged()[name], 3)} {unit}")
        for best in found.by_gain[:1]:
            parts[-1] += f", {readable.shown(factor * best.accuracy.judged()[name], 3)} {unit} {_named(best)}"
    say(figure, readable.titled("; ".join(parts)))
    return figure
