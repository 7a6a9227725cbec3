"""The README's figure and its first two numbers: the paper's reversal under load, with PD alone and compensated.

    python -m experiments.studies.paper.headline docs/figures/reversal.png

simulates on the paper's drive with its 0.1 um scale, prints the errors, and draws.
"""

import sys
from pathlib import Path

from matplotlib.figure import Figure

import diffdrive as dd
from diffdrive.loop.run import Run
from experiments.reports.report import new_figure
from experiments.studies.paper import scenario as paper

KINDS = {  # kind of controller -> its name in the figure, its colour
    "pd": ("PD alone", "C0"),
    "pd+fc": ("friction observer, load unknown", "C1"),
    "pd+fc+ls": ("friction observer, load estimated", "C2"),
}
SHOWN = (1.5, 4.5)  # s, a reversal before the load comes on, and one under it


def simulated(scenario: paper.PaperScenario) -> dict[str, Run]:
    """The scenario under each controller, on the paper's drive with its 0.1 um scale."""
    return {kind: dd.simulate(dd.paper_axis(kind), scenario.motion, scenario.load, throw=True) for kind in KINDS}


def drawn(scenario: paper.PaperScenario, runs: dict[str, Run]) -> Figure:
    """Three panels over time: motion and load, the error of all, and the error of the compensated ones."""
    figure, (motion, error_panel, detail_panel) = new_figure(3, 1, width=8.0, height=1.75)
    time = scenario.motion.time
    motion.plot(time, 1e3 * scenario.motion.velocity, "k", label="velocity, mm/s")
    motion.plot(time, 1e-3 * scenario.load, "C3", label="load, kN")
    motion.set(ylim=(-13, 13))
    motion.legend(loc="center", bbox_to_anchor=(0.5, 0.28), fontsize=8)
    for panel, kinds in ((error_panel, list(KINDS)), (detail_panel, list(KINDS)[1:])):
        for kind in kinds:
            name, colour = KINDS[kind]
            label = f"{name}: {1e6 * runs[kind].rms_error(*paper.AFTER_LOAD):.3g} um RMS"
            panel.plot(time, 1e6 * runs[kind].error, colour, lw=0.8, label=label)
        panel.axvspan(*paper.AFTER_LOAD, color="k", alpha=0.08, lw=0)
    error_panel.set(ylabel="tracking error, um", ylim=(-15, 22))
    error_panel.legend(loc="upper center", fontsize=8, title="at the reversal under 10 kN (shaded)", title_fontsize=8)
    detail_panel.set(ylabel="enlarged, um", ylim=(-0.6, 0.6), xlabel="time, s", xlim=SHOWN)
    return figure


def main(file: Path) -> None:
    """Simulate, print the error at the reversal under load, draw."""
    dd.configure()
    scenario = paper.canonical()
    runs = simulated(scenario)
    for kind, run in runs.items():
        rms, peak = 1e6 * run.rms_error(*paper.AFTER_LOAD), 1e6 * run.peak_error(*paper.AFTER_LOAD)
        sys.stdout.write(f"{KINDS[kind][0]} ({kind}): {rms:.3g} um RMS, {peak:.3g} um peak\n")
    drawn(scenario, runs).savefig(file, dpi=120)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
