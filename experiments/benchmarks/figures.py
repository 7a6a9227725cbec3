"""The figure of a benchmark run."""

from typing import Any

from matplotlib.figure import Figure

from experiments.reports.report import new_figure, plain_logarithmic

PANELS = {
    "single": "One lane, beside the same step by hand",
    "lanes": "Lanes on one core",
    "sweep": "As a sweep runs them, on all cores",
    "controllers": "Controllers",
    "gradients": "Derivatives, one lane",
    "reverse": "Reverse mode, 64 lanes",
    "effects": "Effects",
}


def bench_figure(tables: dict[str, dict[str, Any]]) -> Figure | None:
    """A panel for each part that was run and has one; None where no part has."""
    panels = [name for name in PANELS if name in tables]
    if not panels:
        return None
    figure, axes = new_figure(len(panels), 1, width=9.0, height=4.2, share_x=False)
    panel_axes = [axes] if len(panels) == 1 else list(axes)
    for axis, name in zip(panel_axes, panels, strict=True):
        rows = tables[name]["rows"]
        if name == "single":
            rows = [[f"{implementation}, {substeps} substeps", None, ns] for substeps, implementation, ns, *_ in rows]
        if name == "lanes":
            axis.plot([row[0] for row in rows], [row[1] for row in rows], "o-")
            axis.set(xscale="log", yscale="log", xlabel="lanes", ylabel="ns a lane-step", title=PANELS[name])
            plain_logarithmic(axis.xaxis)
            plain_logarithmic(axis.yaxis)
            continue
        axis.barh(range(len(rows)), [row[2] for row in rows][::-1])
        axis.set_yticks(range(len(rows)), [row[0] for row in rows][::-1], fontsize=7)
        if name != "single":
            axis.axvline(1.0, color="0.3", lw=0.8)
        axis.set(xlabel=tables[name]["columns"][2], title=PANELS[name])
    return figure
