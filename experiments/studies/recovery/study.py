"""How well identification recovers what is known: random drives, logged by a truth machine with its own numerics.

Each draw is a drive within 40 % of the paper's (`random_drive`), logged on the identification motion, without load at
first and under 8 kN later, through a 0.1 um scale with 30 nm of noise, and identified from the paper's drive.
Draws are kept line by line as they come; an interrupted study goes on where it stopped.
"""

import json
import time
from collections.abc import Iterator
from concurrent.futures import as_completed
from pathlib import Path
from typing import NotRequired, TypedDict

import numpy as np
from matplotlib.figure import Figure

from diffdrive.controllers import PDGains
from diffdrive.errors import DiffdriveError, ParameterError
from diffdrive.model.parameters import Drive
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.motion.load import ramp
from diffdrive.runtime import configure, cores
from diffdrive.support.atomic_write import write_text
from diffdrive.support.processes import processes
from diffdrive.support.resources import format_count, require_memory
from experiments.reports.report import Report
from experiments.reports.theme import BLUE, PALE, drawing, new_figure, say

RATE = 4_000.0  # Hz
RESULT, PROCESS = 1e4, 5e8  # bytes: of a draw's rows in memory, and of a process that identifies
LOAD, LOADED = 8_000.0, (6.0, 6.2)  # N, and when it comes on, s
BARS = dict.fromkeys(  # %, that an estimate should be within
    ("mass", "coulomb_at_no_load", "coulomb_screw", "load_coefficient", "viscous", "bristle_stiffness"), 2.0
) | dict.fromkeys(("stribeck_velocity", "breakaway_gap", "bristle_damping"), 10.0)


class EstimateRow(TypedDict):
    """The estimate of one parameter beside its true value; where identification failed there is none."""

    name: str
    true: float
    status: str
    value: NotRequired[float]
    low: NotRequired[float]
    high: NotRequired[float]


class DrawResult(TypedDict):
    """One draw, as a line of `draws.jsonl`."""

    draw: int
    status: str
    seconds: float
    simulations: int
    rows: list[EstimateRow]


def true_values(drive: Drive, believed: Drive) -> dict[str, float]:
    """The true values under the names that identification reports; the nominal damping is taken as known."""
    friction, values = drive.friction, {"mass": drive.plant.mass, "constant_force": drive.plant.constant_force}
    for side in ("positive", "negative"):
        one_side = {name: float(getattr(getattr(friction, name), side)) for name in PER_DIRECTION}
        level = one_side["coulomb_screw"] + one_side["load_coefficient"] * float(friction.initial_load)
        damping = float(getattr(drive.plant.damping, side)) - float(getattr(believed.plant.damping, side))
        values |= {f"{name}.{side}": value for name, value in one_side.items()}
        values |= {f"coulomb_at_no_load.{side}": level, f"viscous.{side}": one_side["viscous"] + damping}
    for name in ("bristle_stiffness", "bristle_damping"):
        values[name] = getattr(friction, name).positive
    return {name: float(value) for name, value in values.items()} | {"delay": 0.0}


SCORED = ("fitted", "at its bound", "failed")  # neither fixed nor reported as undetermined
PER_DIRECTION = ("coulomb_screw", "load_coefficient", "breakaway_gap", "stribeck_velocity", "viscous")


def identify_draw(number: int) -> DrawResult:
    """One drive: drawn, logged, identified."""
    configure()
    from experiments.studies.recovery.excitation import identification_motion
    from experiments.studies.recovery.random_drive import random_drive
    from experiments.studies.recovery.truth import truth_log
    from tuning.identification.identify import identify

    drive, believed = random_drive(np.random.default_rng(number)), paper_drive()
    motion, gains = identification_motion(RATE), PDGains(PAPER_KP, PAPER_KD)
    load = ramp(motion.time, start=LOADED[0], end=LOADED[1], to=LOAD)
    log = truth_log(drive, gains, motion, load, seed=number)
    start = time.perf_counter()
    truth = true_values(drive, believed)
    try:
        identified = identify([log], believed)
        status, simulations = identified.status, identified.simulations
        rows: list[EstimateRow] = [
            {"name": e.name, "true": truth[e.name], "value": e.value, "low": e.low, "high": e.high, "status": e.status}
            for e in identified.estimates
        ]
    except DiffdriveError as error:  # a result, too
        status, simulations = f"failed: {error}", 0
        rows = [EstimateRow(name=name, true=value, status="failed") for name, value in truth.items()]
    return {
        "draw": number,
        "status": status,
        "seconds": round(time.perf_counter() - start, 2),
        "simulations": simulations,
        "rows": rows,
    }


def _read_finished(path: Path) -> list[DrawResult]:
    """The draws in the file; a last line without its end was cut off, and is left out."""
    text = path.read_text(encoding="utf-8")
    return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]


def identify_draws(count: int, path: Path, workers: int) -> Iterator[DrawResult]:
    """Draws 0 to `count` - 1, those in `path` first, the others as they are done and written there."""
    finished = _read_finished(path) if path.exists() else []
    yield from (draw for draw in finished if draw["draw"] < count)
    remaining = sorted(set(range(count)) - {draw["draw"] for draw in finished})
    if not remaining:
        return
    with processes(min(workers, len(remaining))) as pool:
        for future in as_completed([pool.submit(identify_draw, number) for number in remaining]):
            draw = future.result()
            finished.append(draw)
            write_text(path, "".join(json.dumps(draw) + "\n" for draw in finished))
            yield draw


def study(out: Path, count: int = 200, workers: int | None = None) -> None:
    """`diffdrive recovery`: errors and coverage over `count` random drives."""
    workers = cores() if workers is None else workers
    mend = "give fewer"
    require_memory(ParameterError, f"--draws {format_count(count)}: their results", RESULT * count, mend)
    require_memory(ParameterError, f"--workers {format_count(workers)}: as many processes", PROCESS * workers, mend)
    with Report(f"identification of {count} random drives", out) as report:
        draws = []
        with report.progress("draws", count) as advance:
            for draw in identify_draws(count, out / "draws.jsonl", workers):
                draws.append(draw)
                advance(len(draws), count, draw["seconds"])
        rows = summary(draws)
        columns = (
            "parameter", "values", "median error, %", "95 %", "worst", "bar, %", "within it, %", "covered, %",
            "not determined", "at its bound",
        )  # fmt: skip
        report.table("recovery", columns, rows, "Error of the estimate and coverage of the 95 % interval")
        covered, total = coverage(draws)
        report.values(
            "study",
            draws=len(draws),
            converged=sum(draw["status"] == "converged" for draw in draws),
            covered_percent=100.0 * covered / max(total, 1),
            intervals=total,
            median_seconds=float(np.median([draw["seconds"] for draw in draws])),
        )
        report.figure(
            "recovery", recovery_figure(draws),
            f"Error of each estimate over the half-width of its 95 % interval, by parameter, {count} random drives.",
        )  # fmt: skip
        report.result(
            f"Of {total} intervals of {count} random drives {100.0 * covered / max(total, 1):.1f} % hold the true "
            "value; 95 % should."
        )


def _covers(row: EstimateRow) -> bool:
    return row["status"] == "fitted" and row["low"] <= row["true"] <= row["high"]


def _stem(name: str) -> str:
    return name.removesuffix(".positive").removesuffix(".negative")


def _relative(row: EstimateRow) -> float:
    return 100.0 * abs(row["value"] / row["true"] - 1.0)


def summary(draws: list[DrawResult]) -> list[list[object]]:
    """One row for each parameter, both directions together: errors in percent and coverage."""
    stems = list(dict.fromkeys(_stem(row["name"]) for draw in draws for row in draw["rows"]))
    table = []
    for stem in stems:
        rows = [row for draw in draws for row in draw["rows"] if _stem(row["name"]) == stem]
        fitted = [row for row in rows if row["status"] == "fitted"]
        errors = [_relative(row) for row in fitted if row["true"] != 0.0]
        at_bound = sum(row["status"] == "at its bound" for row in rows)
        inside = [_covers(row) for row in rows if row["status"] in SCORED]
        quantiles = [float(np.quantile(errors, q)) for q in (0.5, 0.95, 1.0)] if errors else [None] * 3
        undetermined = sum(row["status"] == "not determined" for row in rows)
        bar = BARS.get(stem)
        within_bar = None if bar is None or not inside else 100.0 * float(np.sum(np.array(errors) <= bar)) / len(inside)
        covered = 100.0 * float(np.mean(inside)) if inside else None
        table.append([stem, len(rows), *quantiles, bar, within_bar, covered, undetermined, at_bound])
    return table


def coverage(draws: list[DrawResult]) -> tuple[int, int]:
    """How many of the intervals hold the truth, and how many there are; an estimate at its bound counts as a miss."""
    inside = [_covers(row) for draw in draws for row in draw["rows"] if row["status"] in SCORED]
    return sum(inside), len(inside)


@drawing
def recovery_figure(draws: list[DrawResult]) -> Figure:
    """Estimate minus truth in half-widths of the interval, per parameter: 95 % should lie within one."""
    stems = list(dict.fromkeys(_stem(row["name"]) for draw in draws for row in draw["rows"]))
    figure, axis = new_figure(height=1.3 + 0.28 * len(stems))
    for k, stem in enumerate(stems):
        rows = [r for draw in draws for r in draw["rows"] if _stem(r["name"]) == stem and r["status"] == "fitted"]
        errors = [2.0 * (r["value"] - r["true"]) / (r["high"] - r["low"]) for r in rows]
        places = k + 0.3 * np.linspace(-1, 1, len(errors))
        axis.plot(np.clip(errors, -4, 4), places, "o", ms=2, mew=0, color=BLUE)
    axis.axvspan(-1, 1, color=PALE, lw=0)
    axis.set(yticks=range(len(stems)), yticklabels=stems, xlim=(-4.2, 4.2), title="shaded: within the interval")
    axis.set_xlabel("error over the half-width of its 95 % interval (ratio)")
    covered, total = coverage(draws)
    say(figure, f"{100.0 * covered / max(total, 1):.1f} % of {total} intervals hold the truth; 95 % should")
    return figure
