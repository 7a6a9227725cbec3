"""The figure of a benchmark run."""

from typing import Any

from experiments.report import new_figure, plain_logarithmic


def drawn(tables: dict[str, Any]) -> Any:
    """What was measured, a panel for each part that was run and has one."""
    panels = [name for name in ("lanes", "controllers", "gradients", "effects") if name in tables]
    figure, axes = new_figure(max(1, len(panels)), 1, width=9.0, height=4.2, share_x=False)
    every = [axes] if len(panels) <= 1 else list(axes)
    for axis, name in zip(every, panels, strict=False):
        rows = tables[name]["rows"]
        if name == "lanes":
            axis.plot([row[0] for row in rows], [row[1] for row in rows], "o-")
            axis.set(xscale="log", yscale="log", xlabel="lanes", ylabel="ns a lane-step", title="Lanes on one core")
            plain_logarithmic(axis.xaxis)
            plain_logarithmic(axis.yaxis)
            continue
        axis.barh(range(len(rows)), [row[2] for row in rows][::-1])
        axis.set_yticks(range(len(rows)), [row[0] for row in rows][::-1], fontsize=7)
        axis.axvline(1.0, color="0.3", lw=0.8)
        axis.set(xlabel=tables[name]["columns"][2], title=name)
    return figure
