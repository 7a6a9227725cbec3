"""Gradient search against a genetic one on one identification problem: simulations and time to equal quality."""

import dataclasses
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree
from matplotlib.figure import Figure

from diffdrive.controllers import Cascade, Controller
from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.loop.simulate import simulate_loop
from diffdrive.model.parameters import Drive, Sensor
from diffdrive.model.quantity import Directional, quantities
from diffdrive.motion.builders import staircase
from diffdrive.numerics.arrays import as_arrays
from experiments.reports.readable import significant, unit_of
from experiments.reports.report import Report
from experiments.reports.theme import drawing, legend_below, new_figure, plain_logarithmic, say, style
from experiments.studies.emps import axis as emps
from experiments.studies.evolution.chart import evolution_chart, excess
from experiments.studies.evolution.two_stage import two_stage
from tuning.identification.identify import COARSE_EVERY, COARSE_STEPS, start_points
from tuning.identification.problem import COARSE_SUBSTEP, Innovations, sampling_of
from tuning.identification.replay import replay_closed_loop
from tuning.identification.setup import build_problem
from tuning.optimisation.evolution import (
    POPULATION,
    Budget,
    Evolution,
    HistoryEntry,
    evolve,
    norm_costs,
    origin_fractions,
)
from tuning.optimisation.least_squares import levenberg_marquardt, multistart
from tuning.optimisation.space import SearchSpace, coordinates

STARTS = 6  # of the gradient search, as in tuning/identification/identify.py
MAX_STEPS = 30  # of its last search
TOLERANCE = 1e-6
MAX_RATIO = 20  # most simulations of evolution over those of the gradient search
SPEEDS = (2e-3, 5e-3, 0.01, 0.02, 0.05, 0.1)  # m/s, of the synthetic log
LEVELS = (0.1, 0.01, 0.001)  # of the gradient search's cost, above it


class EvolutionCase(NamedTuple):
    """A log, the controller under which it was made, and the drive behind it where that is known."""

    log: Log
    controller: Controller
    truth: Drive | None


class Descent(NamedTuple):
    """A gradient search: where it ended, the lowest cost along the way, and why it stopped."""

    theta: Float[np.ndarray, " k"]
    history: list[HistoryEntry]
    status: str

    @property
    def cost(self) -> float:
        """The lowest."""
        return self.history[-1].cost


def descend(residuals: Innovations, args: PyTree, *, seed: int, starts: int, steps: int, last: int) -> Descent:
    """The coarse search of identification: several starts for a few steps, then the best of them to the end.

    A step counts as one simulation and one more for each derivative that it carries along.
    """
    simulations_per_step = 1 + len(residuals.free)
    start, history = time.perf_counter(), list[HistoryEntry]()

    def record(simulations: int) -> Callable[[int, int, float], None]:
        def visit(step: int, most: int, cost: float) -> None:
            least = min(cost, history[-1].cost) if history else cost
            history.append(HistoryEntry(simulations * step + simulations_before, time.perf_counter() - start, least))

        return visit

    points = start_points(residuals.free, starts, seed)
    simulations_before = 0
    ends, costs, _ = multistart(residuals, points, args, steps=steps, progress=record(starts * simulations_per_step))
    simulations_before = starts * steps * simulations_per_step
    search = levenberg_marquardt(
        residuals,
        ends[int(np.argmin(costs))],
        args,
        max_steps=last,
        tolerance=TOLERANCE,
        progress=record(simulations_per_step),
    )
    return Descent(search.theta, history, search.status)


def evolution_study(
    report: Report, case: EvolutionCase, *, seconds: float = 300.0, runs: int = 3, max_ratio: float = MAX_RATIO
) -> None:
    """Both searches in turn on one log, compiled beforehand; then the paper's two-stage route.

    One evolution may take `seconds`, and `max_ratio` times as many simulations as the gradient search.
    """
    if not seconds > 0 or runs < 1:
        raise ParameterError(f"seconds and runs must be positive, got {seconds!r} and {runs!r}")
    report.say(f"Log: {case.log.name}.")
    question = build_problem([case.log], emps.reference_drive(), (), {})
    residuals = Innovations(coordinates(question.free), sampling_of(question.rate, COARSE_SUBSTEP), COARSE_EVERY)
    space, args = SearchSpace(question.free, question.problem.origin), as_arrays(question.problem)
    costs, start = norm_costs(residuals, space, args), origin_fractions(space)
    population = max(5, POPULATION * len(start))

    def gradient(seed: int, steps: int = COARSE_STEPS, last: int = MAX_STEPS) -> Descent:
        return descend(residuals, args, seed=seed, starts=STARTS, steps=steps, last=last)

    compiling = {
        "gradient_s": _seconds(lambda: gradient(0, 1, 1)),
        "evolution_s": _seconds(lambda: costs(np.tile(start, (population, 1)))),
    }
    descents, evolutions = [], []
    for seed in range(runs):
        with report.working(f"gradient search {seed + 1} of {runs}"):
            descents.append(gradient(seed))
        target = (1.0 + min(LEVELS)) * min(descent.cost for descent in descents)
        budget = Budget(int(max_ratio * descents[-1].history[-1].simulations), seconds, target)
        with report.progress(f"differential evolution {seed + 1} of {runs}", budget.simulations) as advance:
            on_visit = _progress_of(advance, budget.simulations)
            evolutions.append(evolve(costs, start, budget, seed=seed, progress=on_visit))
    report.values("problem", parameters=len(start), samples=len(case.log.time), population=population, starts=STARTS)
    report.values("compiling_before", **compiling)
    levels = _report_searches(report, descents, evolutions, case.log.name)
    best = min(descents, key=lambda descent: descent.cost)
    drive, unknowns = residuals.unpack(jnp.asarray(best.theta), question.problem)
    _compare_routes(report, case, with_delay(jax.tree.map(float, drive), float(unknowns.delay)))
    report.result(in_words(levels, budget, runs))


class LevelCost(NamedTuple):
    """Median simulations and seconds until each search is so close to the best cost; None where it is not."""

    level: float
    gradient: tuple[float, float] | None
    evolution: tuple[float, float] | None


def in_words(levels: Sequence[LevelCost], budget: Budget, runs: int) -> str:
    """What equal quality costs: at the closest level that both searches reach, else at the closest of the gradient."""
    both = [one for one in levels if one.gradient and one.evolution]
    found = min(both or levels, key=lambda one: one.level)
    runs_in_words = f"median of {runs} runs" if runs > 1 else "1 run"
    within = f"To come within {100 * found.level:g} % of the best cost ({runs_in_words})"
    if found.gradient is None:
        return f"{within}: half of the gradient searches or more do not."
    gradient = f"{within}, the gradient search takes {_cost_in_words(found.gradient)}"
    if found.evolution is None:
        limit = f"{budget.simulations} simulations or {budget.seconds:g} s"
        return f"{gradient}; differential evolution is not there after {limit}."
    return f"{gradient}, differential evolution {_cost_in_words(found.evolution)}."


def _cost_in_words(cost: tuple[float, float]) -> str:
    return f"{significant(cost[0])} simulations and {significant(cost[1])} s"


def _compare_routes(report: Report, case: EvolutionCase, by_gradient: Drive) -> None:
    """The two-stage route beside the gradient search: parameters, and the force gap in closed loop."""
    with report.working("the two-stage route"):
        staged = two_stage([case.log], emps.reference_drive())
    for note in staged.notes:
        report.say(f"two stages: {note}")
    report.values(
        "two_stage",
        stribeck_rms_N=staged.stribeck_rms,
        hysteresis_rms_N=staged.hysteresis_rms,
        simulations_of_the_hysteresis=staged.evolution.simulations,
    )
    drives = {"starting drive": emps.reference_drive(), "two stages": staged.drive, "gradient": by_gradient}
    if case.truth is not None:
        drives["truth"] = case.truth
    named = [dict(_parameters(drive)) for drive in drives.values()]
    rows: list[list[object]] = [[*key, *(parameters[key] for parameters in named)] for key in named[0]]
    gaps = [replay_closed_loop(drive, case.controller, case.log) for drive in drives.values()]
    rows.append(["force gap in closed loop", "%", *(replay.force_percent for replay in gaps)])
    report.table(
        "routes", ("parameter", "unit", *drives), rows,
        f"Parameters by the two-stage route and by the gradient search, log {case.log.name} (+ forwards, - backwards)",
    )  # fmt: skip


def _parameters(drive: Drive) -> Iterator[tuple[tuple[str, str], float]]:
    """Name and unit of what both routes fit, and its value."""
    for path, declared, value in quantities(drive.plant):
        if path != "damping":
            yield (path, unit_of(declared.unit)), float(value)
    for path, declared, value in quantities(drive.friction):
        if path not in ("load_coefficient", "initial_load", "stribeck_exponent"):  # which are not fitted
            yield (f"{path} +", unit_of(declared.unit)), float(value.positive)
            yield (f"{path} -", unit_of(declared.unit)), float(value.negative)
    delay = drive.actuator.delay_samples + float(drive.actuator.delay_fraction or 0.0)
    yield ("delay", "periods"), delay


def with_delay(drive: Drive, delay: float) -> Drive:
    """The drive with a delay of control periods; a negative one, of a command that was logged late, is set to zero."""
    samples = max(0, int(np.floor(delay)))
    fraction = float(np.clip(delay - samples, 0.0, 1.0))
    actuator = dataclasses.replace(drive.actuator, delay_samples=samples, delay_fraction=fraction or None)
    return dataclasses.replace(drive, actuator=actuator)


def _progress_of(advance: Callable[[int, int, float], None], most: int) -> Callable[[HistoryEntry], None]:
    return lambda visit: advance(min(visit.simulations, most), most, visit.cost)


def _seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def emps_case(folder: Path | None) -> EvolutionCase:
    """The estimation file of EMPS; raises `ParameterError` where the folder does not hold it."""
    data_folder = folder or emps.find_folder()
    if data_folder is None or not (data_folder / emps.FILES["estimation"]).is_file():
        where = "shared/data/emps beside this folder" if folder is None else f"--data {folder}"
        raise ParameterError(
            f"{where}: no {emps.FILES['estimation']} in it; name its folder with --data, or --synthetic"
        )
    record = emps.read(data_folder / emps.FILES["estimation"])
    return EvolutionCase(record.log, emps.controller(record), None)


def synthetic_drive() -> Drive:
    """An axis much as EMPS was identified: friction rises from standstill, and differs by direction."""
    drive = emps.reference_drive()
    friction = dataclasses.replace(
        drive.friction,
        coulomb_screw=Directional(20.0, 23.0),
        breakaway_gap=Directional(-12.0, -11.0),
        stribeck_velocity=Directional(0.011, 0.009),
        viscous=Directional(150.0, 230.0),
    )
    return dataclasses.replace(drive, friction=friction, sensor=Sensor(resolution=emps.COUNT))


def synthetic_case(speeds: Sequence[float] = SPEEDS, travel: float = 12e-3) -> EvolutionCase:
    """That axis under a controller like that of EMPS, there and back over `travel` (m) at each speed (m/s)."""
    motion = staircase(speeds=speeds, travel=travel, acceleration=4.0, rate=emps.SAMPLING.rate)
    cascade = Cascade(kp=160.0, kv=8_500.0, velocity_samples=2)
    run = simulate_loop(synthetic_drive(), cascade, motion, sampling=emps.SAMPLING).require_ok()
    return EvolutionCase(run.log("synthetic"), cascade, synthetic_drive())


def first_visit_below(history: list[HistoryEntry], cost: float) -> HistoryEntry | None:
    """The first visit at or below `cost`, or None."""
    return next((visit for visit in history if visit.cost <= cost), None)


def _report_searches(report: Report, descents: list[Descent], evolutions: list[Evolution], log: str) -> list[LevelCost]:
    """The tables and the figure of the searches; what each level of quality costs."""
    best = min(descent.cost for descent in descents)
    rows = []
    for k, (descent, evolution) in enumerate(zip(descents, evolutions, strict=True)):
        for name, search in (("gradient", descent), ("evolution", evolution)):
            last = search.history[-1]
            rows.append([f"{name} {k + 1}", last.simulations, last.seconds, last.cost / best, search.status])
    report.table("runs", ("search", "simulations", "s", "cost over best", "ended"), rows, "Each search to its end")
    rows, levels = [], list[LevelCost]()
    for level in LEVELS:
        cost = (1.0 + level) * best
        gradient_visits = [first_visit_below(search.history, cost) for search in descents]
        evolution_visits = [first_visit_below(search.history, cost) for search in evolutions]
        g, e = _median_visit(gradient_visits), _median_visit(evolution_visits)
        levels.append(LevelCost(level, g, e))
        times = [e[k] / g[k] if g and e else None for k in (0, 1)]
        counts = [
            f"{sum(visit is not None for visit in visits)} of {len(visits)}"
            for visits in (gradient_visits, evolution_visits)
        ]
        rows.append([f"{100 * level:g} %", counts[0], *(g or (None, None)), counts[1], *(e or (None, None)), *times])
    report.table(
        "equal_quality",
        (
            "within", "gradient", "simulations", "time, s", "evolution", "simulations, evolution", "time, evolution, s",
            "ratio of simulations", "ratio of times",
        ),
        rows,
        "Until the cost is so close to the best gradient search's: how many get there, and the median of all "
        "(-: half of them or more do not within the budget)",
    )  # fmt: skip
    searches: dict[str, Sequence[Descent | Evolution]] = {"gradient": descents, "evolution": evolutions}
    report.data["history"] = {name: [search.history for search in runs] for name, runs in searches.items()}
    caption = f"Cost of each search above the best cost, over simulations and over time, log {log}."
    report.figure("evolution", evolution_figure(report.data["history"], best), caption)
    report.chart("evolution", evolution_chart(report.data["history"], best, caption))
    return levels


@drawing
def evolution_figure(histories: dict[str, list[list[HistoryEntry]]], best: float) -> Figure:
    """How far each search is above the best cost, over simulations and over time."""
    figure, axes = new_figure(1, 2, height=3.0, share_x=False)
    for number, (name, runs) in enumerate(histories.items()):
        for k, history in enumerate(runs):
            simulations, seconds, _ = np.array(history).T
            above = excess(history, best)
            axes[0].loglog(simulations, above, label=None if k else name, **style(number))
            axes[1].loglog(seconds, above, **style(number))
    axes[0].set(
        xlabel="simulations (count)", ylabel="cost above the best, %", title="one derivative counts as one more"
    )
    axes[1].set(xlabel="wall time, s", ylabel="cost above the best, %", title="compiled before")
    for axis in axes:
        plain_logarithmic(axis.xaxis)
        plain_logarithmic(axis.yaxis)
    legend_below(figure)
    ends = {name: 100.0 * (min(history[-1][2] for history in runs) / best - 1.0) for name, runs in histories.items()}
    say(
        figure,
        "Best end above the best cost: " + ", ".join(f"{significant(end, 3)} % {name}" for name, end in ends.items()),
    )
    return figure


def _median_visit(visits: list[HistoryEntry | None]) -> tuple[float, float] | None:
    """Median simulations and seconds, with those that never got there as infinite; None if that is the median."""
    table = [(np.inf, np.inf) if visit is None else (visit.simulations, visit.seconds) for visit in visits]
    simulations, seconds = np.median(np.array(table, dtype=float), axis=0)
    return (float(simulations), float(seconds)) if np.isfinite(simulations) else None
