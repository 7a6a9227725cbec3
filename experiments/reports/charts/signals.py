"""The signals of a run over time, and the tracking errors of several runs of one scenario."""

from collections.abc import Mapping

from diffdrive.loop.run import Run
from experiments.reports.page.chart import Chart, Line, Panel

TIME = "time, s"


def run_chart(run: Run) -> Chart:
    """Position, tracking error, forces and load over time."""
    time, estimated = run.time, "estimated"
    position = [Line("reference", time, 1e3 * run.reference), Line("position", time, 1e3 * run.position)]
    force = [Line("command", time, run.command), Line("friction", time, run.friction)]
    load = [Line("load", time, 1e-3 * run.load)]
    if run.friction_estimate is not None:
        force.append(Line(f"friction, {estimated}", time, run.friction_estimate))
    if run.load_estimate is not None:
        load.append(Line(f"load, {estimated}", time, 1e-3 * run.load_estimate))
    panels = [
        Panel(TIME, "position, mm", position),
        Panel(TIME, "tracking error, µm", [Line("tracking error", time, 1e6 * run.error)]),
        Panel(TIME, "force, N", force),
        Panel(TIME, "load, kN", load),
    ]
    return Chart("Signals of the simulated run over time: position, tracking error, forces, load.", panels)


def before_and_after(name: str, before: Run, after: Run) -> Chart:
    """The tracking error with the gains as given and as tuned, in one scenario."""
    lines = [Line("given", before.time, 1e6 * before.error), Line("tuned", after.time, 1e6 * after.error)]
    caption = f"Tracking error in a scenario that was not used for tuning: {name}."
    return Chart(caption, [Panel(TIME, "tracking error, µm", lines)])


def errors_chart(caption: str, runs: Mapping[str, Run]) -> Chart:
    """The tracking errors of controllers in one scenario; where one of them estimates the load, the load beside it."""
    first = next(iter(runs.values()))
    panels = [
        Panel(TIME, "position, mm", [Line("reference", first.time, 1e3 * first.reference)]),
        Panel(TIME, "tracking error, µm", [Line(name, run.time, 1e6 * run.error) for name, run in runs.items()]),
    ]
    estimates = [
        Line(name, run.time, 1e-3 * run.load_estimate) for name, run in runs.items() if run.load_estimate is not None
    ]
    if estimates:
        panels.append(Panel(TIME, "load, kN", [*estimates, Line("applied", first.time, 1e-3 * first.load)]))
    return Chart(caption, panels)
