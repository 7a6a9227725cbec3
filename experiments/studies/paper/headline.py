"""The README's figure and its first two numbers: the paper's reversal under load, with PD alone and compensated.

    python -m experiments.studies.paper.headline docs/figures/reversal.png

simulates on the paper's drive with its 0.1 um scale, prints the errors, and draws.
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import diffdrive as dd
from diffdrive.loop.run import Run
from experiments.reports.theme import BLACK, PALE, drawing, legend_below, new_figure, save, say, style
from experiments.studies.paper import scenario as paper

KINDS = {  # kind of controller -> its name in the figure
    "pd": "PD alone",
    "pd+fc": "friction observer, load unknown",
    "pd+fc+ls": "friction observer, load estimated",
}
SHOWN = (1.5, 4.5)  # s, a reversal before the load comes on, and one under it


def simulated(scenario: paper.PaperScenario) -> dict[str, Run]:
    """The scenario under each controller, on the paper's drive with its 0.1 um scale."""
    return {kind: dd.simulate(dd.paper_axis(kind), scenario.motion, scenario.load, throw=True) for kind in KINDS}


@drawing
def headline_figure(scenario: paper.PaperScenario, runs: dict[str, Run]) -> Figure:
    """Over time: motion, load, the error of all, and the error of the compensated ones."""
    figure, (motion, load, error_panel, detail_panel) = new_figure(4, 1, height=1.5)
    time = scenario.motion.time
    motion.plot(time, 1e3 * scenario.motion.velocity, color=BLACK)
    motion.set(ylabel="velocity, mm/s")
    load.plot(time, 1e-3 * scenario.load, color=BLACK)
    load.set(ylabel="load, kN")
    errors = {kind: 1e6 * run.rms_error(*paper.AFTER_LOAD) for kind, run in runs.items()}
    for k, kind in enumerate(KINDS):
        for panel in (error_panel, detail_panel) if k else (error_panel,):
            panel.plot(time, 1e6 * runs[kind].error, label=f"{KINDS[kind]}: {errors[kind]:.3g} µm RMS", **style(k))
    for panel in (error_panel, detail_panel):
        panel.axvspan(*paper.AFTER_LOAD, color=PALE, lw=0)
    error_panel.set(ylabel="error, µm", title="tracking error; shaded: the reversal under load, where the RMS is taken")
    detail_panel.set(ylabel="error, µm", title="magnified, without PD alone", xlabel="time, s", xlim=SHOWN)
    figure.align_ylabels()
    legend_below(figure, error_panel)
    least = min(errors.values())
    say(figure, f"Under {1e-3 * scenario.load[-1]:g} kN the error at a reversal falls from {errors['pd']:.3g} µm RMS "
                f"with PD alone to {least:.1g} µm compensated")  # fmt: skip
    return figure


def main(file: Path) -> None:
    """Simulate, print the error at the reversal under load, draw."""
    dd.configure()
    scenario = paper.canonical()
    runs = simulated(scenario)
    for kind, run in runs.items():
        rms, peak = 1e6 * run.rms_error(*paper.AFTER_LOAD), 1e6 * run.peak_error(*paper.AFTER_LOAD)
        sys.stdout.write(f"{KINDS[kind]} ({kind}): {rms:.3g} um RMS, {peak:.3g} um peak\n")
    save(headline_figure(scenario, runs), str(file), file.suffix[1:])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
