"""The figure of a benchmark run."""

from typing import Any

from matplotlib.figure import Figure

from experiments.reports.theme import BLUE, REFERENCE, drawing, new_figure, plain_logarithmic, say

PANELS = {
    "single": "One lane, beside the same step by hand",
    "lanes": "Lanes on one core",
    "sweep": "As a sweep runs them, on all cores",
    "controllers": "Controllers",
    "gradients": "Derivatives, one lane",
    "reverse": "Reverse mode, 64 lanes",
    "effects": "Effects",
}


@drawing
def bench_figure(tables: dict[str, dict[str, Any]]) -> Figure | None:
    """A panel for each part that was run and has one; None where no part has."""
    panels = [name for name in PANELS if name in tables]
    if not panels:
        return None
    figure, axes = new_figure(len(panels), 1, height=2.6, share_x=False)
    panel_axes = [axes] if len(panels) == 1 else list(axes)
    for axis, name in zip(panel_axes, panels, strict=True):
        rows = tables[name]["rows"]
        if name == "single":
            rows = [[f"{implementation}, {substeps} substeps", None, ns] for substeps, implementation, ns, *_ in rows]
        if name == "lanes":
            axis.plot([row[0] for row in rows], [row[1] for row in rows], "o-", color=BLUE)
            axis.set(
                xscale="log",
                yscale="log",
                xlabel="lanes (count)",
                ylabel="time of a lane and step, ns",
                title=PANELS[name],
            )
            plain_logarithmic(axis.xaxis)
            plain_logarithmic(axis.yaxis)
            continue
        axis.barh(range(len(rows)), [row[2] for row in rows][::-1], color=BLUE)
        axis.set_yticks(range(len(rows)), [row[0] for row in rows][::-1])
        if name != "single":
            axis.axvline(1.0, **REFERENCE)
        unit = "time, ns" if name == "single" else f"{tables[name]['columns'][2]} (ratio)"
        axis.set(xlabel=unit, title=PANELS[name])
    first = tables[panels[0]]["rows"]
    column = 1 if panels[0] == "lanes" else 2
    numbers = [float(row[column]) for row in first if row[column] is not None]
    unit = " ns" if panels[0] in ("single", "lanes") else ""
    say(figure, f"{PANELS[panels[0]]}: {min(numbers):.3g} to {max(numbers):.3g}{unit}")
    return figure
