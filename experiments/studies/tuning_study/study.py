"""The gradient tuner against derivative-free searches, on one compiled ensemble, in one run.

The benchmark: loads 0, 5, 10 and 12.6 kN on the paper's machine and on a perturbed one, a sample of delay, 20 nm of
noise; gain margins of 6 dB up and down and a phase margin of 30 degrees at standstill, 1, 3 and 10 mm/s; command noise
of at most 20 N; from the paper's gains.
"""

import time
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.controllers.base import paper_tracking
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Actuator, Drive, Sampling, Sensor
from diffdrive.model.presets import PAPER_KD, PAPER_KP, paper_drive
from diffdrive.numerics.arrays import as_arrays
from diffdrive.observers.friction_observer import LoadStateObserver
from experiments.reports.report import Report
from experiments.reports.theme import drawing, legend_below, new_figure, plain_logarithmic, say, style
from experiments.studies.tuning_study.baselines import BaselineResult, cma_es, costs_of, nelder_mead, random_search
from experiments.studies.tuning_study.penalised import bfgs, levenberg_marquardt
from tuning.gains.constrained import ConstrainedGains, TuningProblem, evaluate, linearise_at, tuning_problem
from tuning.gains.objective import Objective
from tuning.gains.plan import OFF_GRID_FACTOR, SETTLE, machines, reversal
from tuning.gains.requirements import Constraints, LoopLimits, operating_points
from tuning.gains.scenarios import Ensemble, EnsembleSignals, Scenario, ensemble
from tuning.gains.sequential import FEASIBILITY_TOLERANCE
from tuning.gains.tune import GainSearch, default_space, tune
from tuning.optimisation.evolution import Budget
from tuning.optimisation.space import SearchSpace

RATE = 10_000.0
LOADS = (0.0, 5_000.0, 10_000.0, 12_600.0)
SPEEDS = (0.0, 1e-3, 3e-3, 1e-2)
SPREAD = 0.03
USUAL_EVALUATIONS = 255  # evaluations in which CMA-ES comes within 5 % of its own best, by the notes on the paper
BUDGET_FACTOR = 10  # the usual budget, that it gets to find the best there is
TOLERANCES = (0.2, 0.05, 0.01)
MAX_SOLVER_STEPS = 200  # of a solver with penalties: it has arrived long before
STARTS = 10
DECADES = 2.0  # over which random starts are drawn, each gain
SAMPLING = Sampling(RATE, 4)


class TuningBenchmark(NamedTuple):
    """The controller, where it is tried, and what it must keep."""

    controller: Controller
    lanes: Ensemble
    requirements: Constraints


def delayed_drive() -> Drive:
    """The paper's drive with a sample of delay, and 20 nm of white noise in place of the scale's steps."""
    return eqx.tree_at(
        lambda d: (d.actuator, d.sensor),
        paper_drive(),
        (Actuator(delay_samples=1), Sensor(None, 2e-8)),
        is_leaf=lambda leaf: isinstance(leaf, Actuator | Sensor),
    )


def scenarios(seed: int, loads: tuple[float, ...] = LOADS, speed: float = 0.010, other: int = 0) -> list[Scenario]:
    """Reversals under these loads on the nominal machine and on another; `other` draws which."""
    drive = delayed_drive()
    both = [drive, machines(drive, 2, SPREAD, other)[1]]
    motion = reversal(OFF_GRID_FACTOR * speed, RATE)
    pairs = [(machine, load) for machine in both for load in loads]
    return [Scenario(f"{load:g} N", machine, motion, load, seed + k) for k, (machine, load) in enumerate(pairs)]


def benchmark(load_error: float | None = None) -> TuningBenchmark:
    """The benchmark; `load_error` (N) also asks for a true load estimate on the nominal machine."""
    drive = delayed_drive()
    observer = LoadStateObserver(drive.plant, drive.friction)
    controller = FrictionCompensation(paper_tracking(drive, PAPER_KP, PAPER_KD), observer)
    load_error_limits = None if load_error is None else np.r_[np.full(len(LOADS), load_error), np.full(len(LOADS), 1e9)]
    limits = LoopLimits(command_noise=20.0, load_error=load_error_limits)
    grid = operating_points([drive], SPEEDS, (LOADS[0], LOADS[-1]))
    return TuningBenchmark(
        controller, ensemble(scenarios(1), SAMPLING, settle=SETTLE), Constraints(limits, grid, SAMPLING)
    )


def tuning_study(
    report: Report, *, evaluations: int = USUAL_EVALUATIONS * BUDGET_FACTOR, runs: int = 3, starts: int = STARTS
) -> None:
    """Gradient against other searches: quality, evaluations, time; random starts; number of parameters."""
    problem = benchmark()
    space = default_space(problem.controller)
    tuned, best = _race(report, problem, space, evaluations, runs)
    _held_out(report, problem.controller, tuned)
    _true_load(report)
    _starts(report, problem, space, best, starts)
    _parameters(report, problem, evaluations)
    found = float(tuned.point.objective)
    report.result(
        f"The gradient search ends at a mean RMS error of {found:.4g} um, {100.0 * (found / best - 1.0):.2g} % above "
        f"the best that any search found; {report.data['random_starts']['within_5_percent_tuned']} of {starts} random "
        "starts end within 5 % of it."
    )


def _race(
    report: Report, bench: TuningBenchmark, space: SearchSpace, evaluations: int, runs: int
) -> tuple[GainSearch, float]:
    """All searches on one problem; returns the gradient's result and the best objective of any."""
    gains, problem = _compiled(bench, space)
    count = len(space.free)
    tuned = tune(bench.controller, bench.lanes, bench.requirements, space)
    budget = Budget(simulations=evaluations, seconds=600.0)
    results: dict[str, list[BaselineResult]] = {}
    cost = costs_of(gains, problem)
    cost(np.zeros((2, count)))
    with report.progress("other searches", len(SEARCHES) * runs + len(SOLVERS)) as advance:
        for k, (name, search) in enumerate(SEARCHES.items()):
            for seed in range(runs):
                results.setdefault(name, []).append(search(cost, count, budget, seed))
                advance(
                    k * runs + seed + 1, len(SEARCHES) * runs + len(SOLVERS), results[name][-1].history[-1].feasible
                )
        for k, (name, solver) in enumerate(SOLVERS.items()):
            results[name] = [solver(gains, problem, budget._replace(simulations=min(evaluations, MAX_SOLVER_STEPS)))]
            advance(len(SEARCHES) * runs + k + 1, len(SEARCHES) * runs + len(SOLVERS), results[name][0].cost)
    best = min(
        float(tuned.point.objective),
        *(result.history[-1].feasible for result_list in results.values() for result in result_list),
    )
    gradient = [(e, e + count * j, s, f) for e, j, s, f in _evaluation_history(tuned)]
    rows: list[list[object]] = [["gradient", float(tuned.point.objective), *_cost_to_reach(gradient, best)]]
    for name, several in results.items():
        for result in several:
            trail = [(v.simulations, v.simulations, v.seconds, v.feasible) for v in result.history]
            rows.append([name, result.history[-1].feasible, *_cost_to_reach(trail, best)])
    columns = ("search", "best um", *(f"{what} to {100 * w:g} %" for w in TOLERANCES for what in ("evaluations", "s")))
    report.table("race", columns, rows, "Cost to come within so much of the best; a derivative is one evaluation")
    report.values("best", objective_um=best, gradient_um=float(tuned.point.objective), parameters=count)
    evaluated, derivatives_singly, seconds, _ = gradient[-1]
    report.values("gradient", status=tuned.status, starts=[float(start) for start in tuned.start_objectives],
                  evaluations=evaluated, derivatives_counted_singly=derivatives_singly, seconds=seconds)  # fmt: skip
    report.figure("race", race_figure(gradient, results), (
        "Best objective that each search has found so far, over its evaluations and over time, on one ensemble."
    ))  # fmt: skip
    return tuned, best


SEARCHES = {"CMA-ES": cma_es, "Nelder-Mead": nelder_mead, "random": random_search}
SOLVERS = {"BFGS, penalties": bfgs, "Levenberg-Marquardt, penalties": levenberg_marquardt}


def _compiled(bench: TuningBenchmark, space: SearchSpace) -> tuple[ConstrainedGains, TuningProblem]:
    """The problem, its programs compiled."""
    gains = ConstrainedGains(space.free, Objective())
    problem = tuning_problem(as_arrays(smooth(bench.controller)), space, bench.lanes, bench.requirements)
    theta = jnp.zeros(len(space.free))
    compiled = evaluate(gains, theta, problem), linearise_at(gains, theta, problem)
    jax.block_until_ready(compiled)  # type: ignore[no-untyped-call]  # jax declares no types of it
    return gains, problem


def _evaluation_history(tuned: GainSearch) -> list[tuple[int, int, float, float]]:
    """Evaluations, those among them with derivatives, s, and the objective (infinite where a requirement is missed).

    Over the searches from all starts, in order, the look at the starts before them included.
    """
    history, evaluated, derived, seconds = [], len(tuned.start_objectives), 0, tuned.screening_seconds
    for search in tuned.searches:
        for e, j, s, objective, violation in search.state.history:
            value = objective if violation <= FEASIBILITY_TOLERANCE and np.isfinite(objective) else np.inf
            # each search begins with a linearisation
            history.append((evaluated + e + j + 1, derived + j + 1, seconds + s, value))
        evaluated, derived, seconds = history[-1][0], history[-1][1], history[-1][2]
    return history


def _cost_to_reach(trail: list[tuple[int, int, float, float]], best: float) -> list[float | None]:
    """Evaluations and seconds until the objective was within each share of the best; None where it never was."""
    costs: list[float | None] = []
    for share in TOLERANCES:
        first = next((entry for entry in trail if entry[3] <= (1.0 + share) * best), None)
        costs += [None, None] if first is None else [first[0], round(first[2], 2)]
    return costs


@drawing
def race_figure(gradient: list[tuple[int, int, float, float]], results: dict[str, list[BaselineResult]]) -> Figure:
    """The best objective so far over evaluations and over time: the gradient search, and each of the others."""
    figure, axes = new_figure(1, 2, height=3.2, share_x=False)
    for axis, column, what in ((axes[0], 0, "evaluations (count)"), (axes[1], 2, "time, s")):
        for k, (name, several) in enumerate(results.items()):
            for n, result in enumerate(several):
                x = [v.simulations if column == 0 else v.seconds for v in result.history]
                y = [v.feasible for v in result.history]
                axis.step(x, y, lw=0.9, where="post", label=name if n == 0 else None, **style(k + 1))
        least = np.minimum.accumulate([entry[3] for entry in gradient])
        axis.step([entry[column] for entry in gradient], least, lw=2, where="post", label="gradient", **style(0))
        axis.set(xscale="log", yscale="log", xlabel=what, ylabel="mean RMS error, µm")
        plain_logarithmic(axis.xaxis)
        plain_logarithmic(axis.yaxis)
    legend_below(figure, axes[0])
    ends = {"gradient": min(entry[3] for entry in gradient)}
    ends |= {name: min(result.history[-1].feasible for result in several) for name, several in results.items()}
    say(figure, "Least mean RMS error found: " + ", ".join(f"{end:.3g} µm {name}" for name, end in ends.items()))
    return figure


def _mean_rms(controller: Controller, several: list[Scenario]) -> tuple[float, float]:
    """Mean RMS (um) and mean command noise (N) of scenarios."""
    signals = _signals(as_arrays(smooth(controller)), ensemble(several, SAMPLING, settle=SETTLE))
    errors, noises = (np.sqrt(np.mean(np.square(signal), axis=1)) for signal in (signals.error, signals.command_change))
    return 1e6 * float(np.mean(errors)), float(np.mean(noises))


@eqx.filter_jit
def _signals(controller: Controller, lanes: Ensemble) -> EnsembleSignals:
    return lanes.signals(controller)


def _held_out(report: Report, nominal: Controller, tuned: GainSearch) -> None:
    """Other loads, another machine, other noise, other speeds."""
    cases = {
        "loads in between": scenarios(101, (2_500.0, 7_500.0, 11_300.0)),
        "another machine": scenarios(201, other=7),
        "3 mm/s": scenarios(301, speed=0.003),
        "20 mm/s": scenarios(401, speed=0.020),
    }
    rows = []
    for name, several in cases.items():
        before, after = _mean_rms(nominal, several), _mean_rms(tuned.controller, several)
        rows.append([name, before[0], after[0], before[1], after[1]])
    columns = ("held out", "RMS um", "RMS tuned", "noise N", "noise tuned")
    report.table("held_out", columns, rows, "Mean over the lanes, on scenarios that were not tuned on")


def _true_load(report: Report) -> None:
    """The load estimate kept true: at most 300 N of RMS error on the nominal machine."""
    bench = benchmark(load_error=300.0)
    tuned = tune(bench.controller, bench.lanes, bench.requirements, default_space(bench.controller))
    signals = _signals(as_arrays(smooth(tuned.controller)), bench.lanes)
    assert signals.load_error is not None
    errors = np.sqrt(np.mean(np.square(signals.load_error), axis=1))
    report.values("true_load", objective_um=float(tuned.point.objective), feasible=tuned.feasible,
                  worst_nominal_load_error_N=float(np.max(errors[: len(LOADS)])))  # fmt: skip


def _starts(report: Report, bench: TuningBenchmark, space: SearchSpace, best: float, starts: int) -> None:
    """Random starts over two decades of each gain, each tuned as `diffdrive tune` does."""
    rng = np.random.default_rng(0)
    rows: list[list[Any]] = []
    with report.progress("random starts", starts) as advance:
        for k in range(starts):
            shift = _random_shift(space, rng)
            tuned = tune(
                bench.controller, bench.lanes, bench.requirements, SearchSpace(space.free, space.origin + shift)
            )
            growth = float(np.max(np.asarray(tuned.point.constraints["stability"])))
            initial_growth = float(np.max(np.asarray(tuned.initial_point.constraints["stability"])))
            objective = float(tuned.point.objective)
            one_search = float(tuned.start_objectives[0])
            excess = [cost / best - 1.0 for cost in (one_search, objective)]
            rows.append([k, initial_growth <= 0, tuned.status, objective, *excess, growth <= 0, tuned.feasible])
            advance(k + 1, starts, objective)
    columns = ("start", "began stable", "status", "objective um", "one search, over the best", "over the best",
               "stable", "feasible")  # fmt: skip
    report.table("starts", columns, rows, f"Starts drawn over {DECADES:g} decades of each gain")
    near = {name: sum(bool(row[7]) and row[k] <= 0.05 for row in rows) for k, name in ((4, "one_search"), (5, "tuned"))}
    report.values("random_starts", of=starts, unstable_results=sum(not row[6] for row in rows),
                  **{f"within_5_percent_{name}": count for name, count in near.items()})  # fmt: skip


def _random_shift(space: SearchSpace, rng: np.random.Generator) -> np.ndarray:
    """Shifts of y that move each gain by an even share of two decades about where it is, within its bounds."""
    shifts = []
    for free, origin in zip(space.free, space.origin, strict=True):
        share = 1.0 / (1.0 + np.exp(-origin)) + DECADES * rng.uniform(-0.5, 0.5) * np.log(10.0) / np.log(
            free.high / free.low
        )
        share = np.clip(share, 0.02, 0.98)
        shifts.append(np.log(share / (1.0 - share)) - origin)
    return np.array(shifts)


def _parameters(report: Report, bench: TuningBenchmark, evaluations: int) -> None:
    """Cost to come within 5 % against the number of parameters."""
    full = default_space(bench.controller, friction=True)
    rows = []
    for count in (2, 4, 7, 14, len(full.free)):
        space = SearchSpace(full.free[:count], full.origin[:count])
        gains, problem = _compiled(bench, space)
        tuned = tune(bench.controller, bench.lanes, bench.requirements, space)
        cost = costs_of(gains, problem)
        cost(np.zeros((2, count)))
        start = time.perf_counter()
        other = cma_es(cost, count, Budget(simulations=evaluations, seconds=600.0), 0)
        best = min(float(tuned.point.objective), other.history[-1].feasible)
        gradient_cost = next((e for e in _evaluation_history(tuned) if e[3] <= 1.05 * best), None)
        cma_cost = next((v for v in other.history if v.feasible <= 1.05 * best), None)
        rows.append(
            [
                count, float(tuned.point.objective), other.history[-1].feasible,
                None if gradient_cost is None else gradient_cost[0],
                None if gradient_cost is None else gradient_cost[2],
                None if cma_cost is None else cma_cost.simulations, None if cma_cost is None else cma_cost.seconds,
                time.perf_counter() - start,
            ]
        )  # fmt: skip
        report.say(f"{count} parameters: gradient {rows[-1][1]:.5f}, CMA-ES {rows[-1][2]:.5f} um")
    columns = (
        "parameters", "gradient um", "CMA-ES um", "gradient evaluations", "gradient s", "CMA-ES evaluations",
        "CMA-ES s", "CMA-ES s in all",
    )  # fmt: skip
    report.table("parameters", columns, rows, "Cost to come within 5 % of the better of both")
    report.figure("parameters", parameters_figure(rows), (
        "What it costs to come within 5 % of the better of both searches, over the number of gains that are tuned."
    ))  # fmt: skip


@drawing
def parameters_figure(rows: list[list[Any]]) -> Figure:
    """Evaluations and time of both searches over the number of parameters; no mark: not within 5 % of the better."""
    figure, axes = new_figure(1, 2, height=3.0, share_x=False)
    for axis, ours, theirs, what in ((axes[0], 3, 5, "evaluations (count)"), (axes[1], 4, 6, "time, s")):
        for k, (column, mark, name) in enumerate(((ours, "o", "gradient"), (theirs, "s", "CMA-ES"))):
            axis.plot([row[0] for row in rows], [row[column] or np.nan for row in rows], mark, label=name, **style(k))
        axis.set(xlabel="parameters (count)", ylabel=what, yscale="log")
        plain_logarithmic(axis.yaxis)
    axes[0].set_title("no mark: not within 5 % of the better of both")
    legend_below(figure, axes[0])
    within = [sum(row[column] is not None for row in rows) for column in (3, 5)]
    say(figure, f"Within 5 % of the better in {within[0]} of {len(rows)} cases by gradient, in {within[1]} by CMA-ES")
    return figure
