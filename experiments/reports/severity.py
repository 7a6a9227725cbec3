"""`diffdrive severity`: the accuracy of an axis with and without each of its effects, and a picture of it."""

from typing import TYPE_CHECKING

import numpy as np

from experiments.reports import readable
from experiments.reports.report import Report, new_figure
from tuning.accuracy.result import SOUND, TERMS, SeverityResult, Without

if TYPE_CHECKING:
    from matplotlib.figure import Figure

AS_IT_IS, MENDED = "as it is", "sound"


def report_severity(report: Report, found: SeverityResult) -> None:
    """What to mend first, the table of all machines, the figure, and `severity.json`."""
    unit, factor = found.unit
    report.keep("severity", first=None if found.first is None else found.first.effect, beyond=list(found.beyond))
    for line in found.summary().splitlines():
        report.say(readable.titled(line.removeprefix("- ")))
    kept = [name for name in TERMS if getattr(found.as_it_is, name) is not None]
    rows = [
        [machine, *(factor * getattr(accuracy, name) for name in kept)]
        for machine, accuracy in ((AS_IT_IS, found.as_it_is), *((_named(one), one.accuracy) for one in found.without))
    ]
    symbols = [f"{TERMS[name].rpartition(' ')[2]} {unit.replace('µ', 'u')}" for name in kept]
    notes = [", ".join(f"{TERMS[name].rpartition(' ')[2]}: {TERMS[name].rpartition(' ')[0]}" for name in kept) + "."]
    report.table("severity", ("machine", *symbols), rows, "ISO 230-2 and 230-4, simulated", notes=notes)
    if report.out is not None:
        found.save(report.out)
        report.figure("severity", severity_figure(found))


def _named(one: Without) -> str:
    return MENDED if one.effect == SOUND else f"without {one.effect}"


def severity_figure(found: SeverityResult) -> "Figure":
    """Bars of accuracy A and circular deviation G: as it is, without each effect, without any; the tolerance."""
    unit, factor = found.unit
    machines = [(AS_IT_IS, found.as_it_is)]
    machines += [(_named(one), one.accuracy) for one in [*found.by_gain, found.without[-1]]]
    judged = list(found.as_it_is.judged())
    figure, axis = new_figure(1, 1, width=8.0, height=1.2 + 0.45 * len(machines))
    (axis,) = np.ravel(axis)
    places, height = np.arange(len(machines)), 0.8 / len(judged)
    for k, name in enumerate(judged):
        values = [factor * one.judged()[name] for _, one in machines]
        bars = axis.barh(places + (k - 0.5 * (len(judged) - 1)) * height, values, height, label=TERMS[name])
        axis.bar_label(bars, [f"{value:.3g}" for value in values], padding=3, fontsize=8)
    if found.tolerance is not None:
        axis.axvline(factor * found.tolerance, color="k", lw=1.0, ls="--", label="tolerance")
    axis.set_yticks(places, [name for name, _ in machines])
    axis.invert_yaxis()
    axis.margins(x=0.12)
    axis.set(xlabel=unit)
    axis.legend(loc="lower right", fontsize=8)
    return figure
