"""The missing force over time and over position: of an identification, of two side by side, and of a diagnosis."""

from collections.abc import Mapping, Sequence

import numpy as np

from diffdrive.logs import Log
from experiments.reports.charts.stretches import as_lines
from experiments.reports.page.chart import Chart, Line, Panel
from tuning.diagnosis.diagnose import Diagnosis
from tuning.diagnosis.judgement.ladder import ModelComparison
from tuning.identification.identify import Identification

TIME, POSITION, FORCE = "time, s", "position, mm", "missing force, N"
BLANK = np.array([np.nan])  # between stretches: no line joins them


GAPS = "blank where the table rests, and where nothing is held out"
SIDES = (("forwards", 1), ("backwards", -1))


def of_identification(found: Identification, stretches: Sequence[Log], names: str) -> Chart:
    """Over time, the stretches one after another; and over position, by direction."""
    time, force, position, speed = joined(found, stretches)
    sides = [Line(name, position[side * speed > 0], force[side * speed > 0], "points") for name, side in SIDES]
    over_time = Panel(TIME, FORCE, [Line("missing force", *over_the_time(time, force))])
    where = Panel(TIME, POSITION, [Line("position", time, position)])
    caption = f"Missing force of the identified drive over time, one log after another, and over position: {names}."
    return Chart(caption, [where, over_time, Panel(POSITION, FORCE, sides)])


def over_the_time(time: np.ndarray, force: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines that can be seen, of stretches with a blank time behind each, which no line joins."""
    span = float(np.nanmax(time) - np.nanmin(time))
    between = np.flatnonzero(np.isnan(time))[:-1] + 1
    stretches = zip(np.split(time, between), np.split(force, between), strict=True)
    times, lines = zip(*(as_lines(*one, span) for one in stretches), strict=True)
    return np.concatenate(times), np.concatenate(lines)


def of_comparison(sets: Mapping[str, tuple[Identification, Sequence[Log]]]) -> Chart:
    """Over position, a panel for each direction: what lies along the stroke is where it was, or has changed."""
    sides = {name: joined(*one) for name, one in sets.items()}
    panels = [
        Panel(POSITION, f"missing force, {direction}, N", [
            Line(name, position, np.where(side * speed > 0, force, np.nan))
            for name, (_, force, position, speed) in sides.items()
        ])
        for direction, side in SIDES
    ]  # fmt: skip
    caption = f"Missing force over position, {' and '.join(sets)}, each with the drive identified from its own logs."
    return Chart(caption, panels)


def joined(found: Identification, stretches: Sequence[Log]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Time (s), missing force (N), position (mm) and velocity, the stretches one after another, blank between them."""
    times, forces, positions, speeds = [], [], [], []
    begin = 0.0
    for one, missing, velocity in zip(stretches, found.missing_force, found.velocity, strict=True):
        count = len(one.time)
        time = begin + one.time - one.time[0]
        begin = time[-1] + 1.0 / one.rate
        times += [time, BLANK]
        forces += [missing[:count], BLANK]
        positions += [1e3 * one.position, BLANK]
        speeds += [velocity[:count], BLANK]
    return np.concatenate(times), np.concatenate(forces), np.concatenate(positions), np.concatenate(speeds)


def of_diagnosis(found: Diagnosis, logs: Sequence[Log]) -> Chart | None:
    """Of the last log that was held out: recalibrated, and with what was found; None where no filter could tell."""
    log = found.split.logs[-1]
    models = [("recalibrated", found.comparisons[1])]
    if len(found.comparisons) > 2:
        models.append(("with what was found", found.comparisons[-1]))
    over_time, over_position = [], []
    for name, comparison in models:
        if not comparison.force.is_known:
            continue
        time, position, force = of_log(found, comparison, log)
        over_time.append(Line(name, *over_the_time(time, force)))
        known = np.isfinite(force)
        over_position.append(Line(name, position[known], force[known], "points"))
    if not over_time:
        return None
    caption = f"Missing force over time and over position, {logs[log].name}: {found.split.says} ({GAPS})."
    return Chart(caption, [Panel(TIME, FORCE, over_time), Panel(POSITION, FORCE, over_position)])


def of_log(found: Diagnosis, comparison: ModelComparison, log: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time (s), position (mm) and missing force (N) of a log, blank where nothing is judged."""
    rate, starts = found.logged.sampling.rate, np.asarray(found.logged.starts)
    times, positions, forces = [], [], []
    for lane in (lane for lane, owner in enumerate(found.logged.owner) if owner == log):
        counts = comparison.force.counts[lane] > 0
        times += [starts[lane] + np.arange(counts.size) / rate, BLANK]
        positions += [1e3 * np.asarray(comparison.force.trajectory.position[lane]), BLANK]
        forces += [np.where(counts, comparison.force.force[lane], np.nan), BLANK]
    return np.concatenate(times), np.concatenate(positions), np.concatenate(forces)
