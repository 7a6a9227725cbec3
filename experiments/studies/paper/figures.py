"""The paper's figures, drawn from our runs."""

import numpy as np
from matplotlib.figure import Figure

from diffdrive.loop.run import Run
from experiments.reports.report import new_figure
from experiments.studies.paper import scenario as paper

Curve = tuple[np.ndarray, np.ndarray]  # position (m) and friction (N)


def figure_4(rows: np.ndarray) -> Figure:
    """Coulomb friction of screw and guide over the applied load."""
    figure, (screw, guide) = new_figure(1, 2, height=3.2)
    for axis, column, name in ((screw, 1, "ball screw"), (guide, 2, "LM guide")):
        axis.plot(1e-3 * rows[:, 0], rows[:, column], "o-", label="positive direction")
        axis.plot(1e-3 * rows[:, 0], rows[:, column + 2], "s--", label="negative direction")
        axis.set(
            xlabel="applied load, kN",
            ylabel="Coulomb friction, N",
            title=f"({'ab'[column - 1]}) {name}",
            ylim=(0, None),
        )
        axis.legend(loc="lower right")
    screw.set_ylim(0, 80)
    return figure


def figure_5(speeds: np.ndarray, stribeck: dict[float, np.ndarray], loops: dict[float, Curve]) -> Figure:
    """Stribeck and hysteresis curves of the guide under load."""
    figure, (left, right) = new_figure(1, 2, width=9.5, height=3.6, share_x=False)
    for weight in stribeck:
        label = f"{weight / 1e3:g} kN"
        for side in (speeds < 0, speeds > 0):
            left.plot(1e3 * speeds[side], stribeck[weight][side], color=f"C{list(stribeck).index(weight)}")
        position, force = loops[weight]
        right.plot(1e6 * position, force, label=label)
    left.set(xlabel="velocity, mm/s", ylabel="guide friction, N", title="(a) Stribeck curve")
    right.set(xlabel="position, um", ylabel="guide friction, N", title="(b) hysteresis")
    right.legend(loc="center", fontsize=8, title="applied load", title_fontsize=8)
    return figure


def figure_7(scenario: paper.PaperScenario, runs: dict[str, Run]) -> Figure:
    """Position, load and tracking errors of all controllers."""
    figure, axes = new_figure(4, 1, width=9.0, height=2.0)
    time = scenario.motion.time
    axes[0].plot(time, 1e3 * scenario.motion.position)
    axes[0].set(ylabel="position, mm", title="(a) reference")
    axes[1].plot(time, 1e-3 * scenario.load, "k", label="applied")
    for name, colour in (("PD+FC+LE", "C4"), ("PD+FC+LS", "C5")):
        axes[1].plot(time, 1e-3 * np.asarray(runs[name].load_estimate), colour, lw=0.8, label=f"estimated, {name}")
    axes[1].set(ylabel="load, kN", title="(b) applied load")
    axes[1].legend(fontsize=8)
    for axis, names, title in (
        (axes[2], list(runs), "(c) tracking error, all"),
        (axes[3], list(runs)[1:], "(d) tracking error, without PD"),
    ):
        for name in names:
            axis.plot(time, 1e6 * runs[name].error, lw=0.8, color=f"C{list(runs).index(name)}", label=name)
        axis.set(ylabel="error, um", title=title)
        axis.legend(fontsize=7, ncols=1, loc="center left")
    axes[3].set(xlabel="time, s", ylim=(-3, 3), xlim=(1.5, 4.5))
    return figure


def figure_8(speeds: np.ndarray, stribeck: np.ndarray, loop: Curve) -> Figure:
    """Stribeck and hysteresis curves of the whole drive from the identified parameters."""
    figure, (left, right) = new_figure(1, 2, width=9.0, height=3.4, share_x=False)
    for side in (speeds < 0, speeds > 0):
        left.plot(1e3 * speeds[side], stribeck[side], "C0")
    left.set(xlabel="velocity, mm/s", ylabel="friction, N", title="(a) Stribeck curve")
    position, force = loop
    right.plot(1e6 * position, force)
    right.set(xlabel="position, um", ylabel="friction, N", title="(b) hysteresis")
    return figure


def figure_9(runs: dict[str, Run]) -> Figure:
    """Friction estimated by the observer, and tracking errors, without load."""
    figure, axes = new_figure(3, 1, width=9.0, height=2.2)
    observed = runs["PD+FC"]
    axes[0].plot(observed.time, 1e3 * observed.reference)
    axes[0].set(ylabel="position, mm", title="(a) reference")
    axes[1].plot(observed.time, np.asarray(observed.friction_estimate), "C3", lw=0.8, label="estimated")
    axes[1].plot(observed.time, observed.friction, "k", lw=1.0, label="true")
    axes[1].set(ylabel="friction, N", title="(b, c) friction, screw and guide together")
    axes[1].legend(fontsize=8)
    for name, run in runs.items():
        axes[2].plot(run.time, 1e6 * run.error, lw=0.8, label=name)
    axes[2].set(xlabel="time, s", ylabel="error, um", title="(d) tracking error", ylim=(-3, 3))
    axes[2].legend(fontsize=8)
    return figure


def figure_10(experiments: dict[float, dict[str, Run]]) -> Figure:
    """Friction, tracking error and estimated load under the two loads of Table 4."""
    figure, axes = new_figure(3, 2, width=11.0, height=2.4)
    for column, (kilonewtons, runs) in enumerate(experiments.items()):
        first = next(iter(runs.values()))
        part = (first.time >= 4.0) & (first.time <= 7.0)
        axes[0, column].plot(first.time[part], first.friction[part], "k", label="true")
        for k, (name, run) in enumerate(runs.items()):
            style = {"color": f"C{k}", "lw": 0.8, "label": name}
            axes[0, column].plot(run.time[part], np.asarray(run.friction_estimate)[part], **style)
            axes[1, column].plot(run.time[part], 1e6 * run.error[part], **style)
            if run.load_estimate is not None:
                axes[2, column].plot(run.time[part], 1e-3 * run.load_estimate[part], **style)
        axes[2, column].plot(first.time[part], 1e-3 * first.load[part], "k", lw=0.6, label="true: load and ripple")
        axes[0, column].set(ylabel="friction, N", title=f"{kilonewtons} kN")
        axes[1, column].set(ylabel="error, um")
        axes[2, column].set(ylabel="load, kN", xlabel="time, s")
    axes[0, 1].legend(fontsize=7, loc="center right")
    axes[2, 1].legend(fontsize=7, loc="lower right")
    return figure
