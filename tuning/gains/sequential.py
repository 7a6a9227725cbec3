"""A search within requirements, step by step: Gauss-Newton quadratic programs in a trust region.

At each point the objective becomes a quadratic and every requirement a line, those that are kept too, so that a step
goes up to a requirement and not over it. (Least squares with penalties sees a requirement only once it is missed, and
then takes it for a wall: docs/method/tuning.md.) The multipliers say what each requirement costs. Fletcher 1981;
Nocedal & Wright, Numerical Optimization, chapter 18.
"""

import dataclasses
import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from tuning.gains.constrained import (
    ConstrainedGains,
    DesignPoint,
    LinearisedPoint,
    TuningProblem,
    evaluate,
    linearise_at,
)
from tuning.gains.restoration import is_simulable, stabilising_step
from tuning.optimisation.least_distance import quadratic_program
from tuning.optimisation.least_squares import StepProgress, no_progress

FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 0.5, 2.0, 1e-3  # units of y
ACCEPTED_RATIO, GOOD_RATIO = 0.05, 0.7  # share of the foretold gain
FEASIBILITY_TOLERANCE = 5e-3  # a requirement missed by less counts as kept
MIN_GAIN = 1e-3  # of the objective, that a step must foretell, and three have gained, to be worth going on
STALLED_STEPS = 3
MAX_CUTS, CUT_TOLERANCE = 12, 1e-4  # at most, and how far a requirement may bend beyond its line
PENALTY_FACTOR = 2.0  # of a missed requirement, over its multiplier
RELAXATIONS = (1.0, 0.5, 0.25, 0.0)  # share of what is missed that one step is to mend


@dataclass(frozen=True)
class SearchState:
    """Where a search stands after a step: all that it needs to go on, and numbers alone."""

    y: tuple[float, ...]
    radius: float = FIRST_RADIUS
    price: float = 0.0
    steps: int = 0
    evaluations: int = 0  # of the objective, forward
    linearisations: int = 0  # with derivatives
    seconds: float = 0.0
    history: tuple[tuple[int, int, float, float, float], ...] = ()  # evaluations, linearisations, s, objective, missed
    status: str = "running"
    best: tuple[float, ...] | None = None  # y of the lowest objective with every requirement kept
    best_objective: float = np.inf


@dataclass(frozen=True)
class SearchResult:
    """The end of a search: the point, its worth, and the price of each requirement there."""

    standing: SearchState
    at: LinearisedPoint
    multipliers: dict[str, Float[np.ndarray, " n"]]

    @property
    def y(self) -> Float[np.ndarray, " k"]:
        """The point."""
        return np.array(self.standing.y)


def search(
    gains: ConstrainedGains,
    problem: TuningProblem,
    begin: SearchState,
    *,
    max_steps: int = 40,
    progress: StepProgress = no_progress,
    keep: Callable[[SearchState], None] = lambda _: None,
) -> SearchResult:
    """Search on from `begin` until no step gains, `max_steps`, or Ctrl-C; `keep` is given the standing after each step.

    A search that is begun again from a standing takes the same steps as if it had not been stopped.
    """
    now, began = begin, time.perf_counter() - begin.seconds
    at = _linearised(gains, problem, now)
    try:
        while now.status == "running":
            now, at = (_step if is_simulable(at.point) else _stabilise)(gains, problem, now, at)
            now = dataclasses.replace(now, seconds=time.perf_counter() - began)
            entry = (now.evaluations, now.linearisations, now.seconds, *_objective_and_violation(at.point))
            now = dataclasses.replace(now, history=(*now.history, entry))
            if entry[4] <= FEASIBILITY_TOLERANCE and entry[3] < now.best_objective:
                now = dataclasses.replace(now, best=now.y, best_objective=entry[3])
            if now.status == "running" and _stalled(now.history):
                now = dataclasses.replace(now, status="converged")
            if now.status == "running" and now.steps >= max_steps:
                now = dataclasses.replace(now, status=f"stopped after {max_steps} steps")
            keep(now)
            progress(now.steps, max_steps, entry[3])
    except KeyboardInterrupt:
        now = dataclasses.replace(now, status=f"interrupted after {now.steps} steps")
    missed = _objective_and_violation(at.point)[1] > FEASIBILITY_TOLERANCE
    if missed and now.best is not None:  # stopped on the way
        now = dataclasses.replace(now, y=now.best)
        at = _linearised(gains, problem, now)
    elif missed and now.status == "converged":
        now = dataclasses.replace(now, status="infeasible: no step brings it nearer to what is required")
    prices = _solve_subproblem(at, max(now.radius, SMALLEST_RADIUS))[1] if is_simulable(at.point) else {}
    return SearchResult(now, at, prices)


def _stalled(history: tuple[tuple[int, int, float, float, float], ...]) -> bool:
    """Whether the last points that were taken, all within the requirements, gained next to nothing."""
    taken = [entry for before, entry in itertools.pairwise(history) if entry[1] > before[1]]
    if len(taken) <= STALLED_STEPS or max(entry[4] for entry in taken[-1 - STALLED_STEPS :]) > FEASIBILITY_TOLERANCE:
        return False
    return taken[-1 - STALLED_STEPS][3] - taken[-1][3] < MIN_GAIN * taken[-1][3]


def _linearised(gains: ConstrainedGains, problem: TuningProblem, now: SearchState) -> LinearisedPoint:
    return linearise_at(gains, jnp.asarray(now.y), problem)


def _objective_and_violation(point: DesignPoint) -> tuple[float, float]:
    return float(point.objective), float(point.missed)


def _merit(point: DesignPoint, price: float) -> float:
    """Objective and the price of what is missed; infinite where the loop diverges."""
    missed = sum(max(0.0, float(jnp.max(values))) for values in point.kept.values())
    merit = float(point.objective) + price * missed
    return merit if np.isfinite(merit) else np.inf


def _stabilise(
    gains: ConstrainedGains, problem: TuningProblem, now: SearchState, at: LinearisedPoint
) -> tuple[SearchState, LinearisedPoint]:
    """One step of an unstable loop towards a stable one, whatever it does to the objective."""
    d = stabilising_step(at, now.radius)
    now = dataclasses.replace(now, steps=now.steps + 1)
    if d is None:
        return dataclasses.replace(now, status="unstable: nothing near these gains is stable"), at
    there_y = tuple(float(one) for one in np.array(now.y) + d)
    there = evaluate(gains, jnp.asarray(there_y), problem)
    now = dataclasses.replace(now, evaluations=now.evaluations + 1)
    if not float(jnp.max(there.kept["stability"])) < float(jnp.max(at.point.kept["stability"])):
        radius = 0.3 * min(now.radius, float(np.max(np.abs(d))))
        status = "running" if radius > SMALLEST_RADIUS else "unstable: no step from here makes the loop more stable"
        return dataclasses.replace(now, radius=radius, status=status), at
    now = dataclasses.replace(now, y=there_y, linearisations=now.linearisations + 1)
    at = _linearised(gains, problem, now)
    return dataclasses.replace(now, radius=FIRST_RADIUS if is_simulable(at.point) else LARGEST_RADIUS), at


def _step(
    gains: ConstrainedGains, problem: TuningProblem, now: SearchState, at: LinearisedPoint
) -> tuple[SearchState, LinearisedPoint]:
    """One quadratic program and the trial of its answer."""
    d, prices = _solve_subproblem(at, now.radius)
    dearest = max(float(np.sum(one)) for one in prices.values())
    price = max(now.price, PENALTY_FACTOR * dearest, float(at.point.objective))
    gain = _merit(at.point, price) - _predicted_merit(at, d, price)
    now = dataclasses.replace(now, price=price, steps=now.steps + 1)
    if gain < MIN_GAIN * float(at.point.objective):
        return dataclasses.replace(now, status="converged"), at
    trial = jnp.asarray(np.array(now.y) + d)
    there = evaluate(gains, trial, problem)
    now = dataclasses.replace(now, evaluations=now.evaluations + 1)
    share = (_merit(at.point, price) - _merit(there, price)) / gain
    longest = float(np.max(np.abs(d)))
    if not share > ACCEPTED_RATIO:
        radius = 0.3 * min(now.radius, longest)
        return dataclasses.replace(now, radius=radius, status=_trust_region_status(radius)), at
    radius = min(LARGEST_RADIUS, 2.0 * now.radius) if share > GOOD_RATIO and longest > 0.9 * now.radius else now.radius
    there_y = tuple(float(one) for one in trial)
    now = dataclasses.replace(now, y=there_y, radius=radius, linearisations=now.linearisations + 1)
    return now, _linearised(gains, problem, now)


def _trust_region_status(radius: float) -> str:
    return "running" if radius > SMALLEST_RADIUS else "converged"


def _solve_subproblem(at: LinearisedPoint, radius: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The step within the radius that keeps the requirements, or mends as large a share of them as it can."""
    names = list(at.point.kept)
    values = np.concatenate([np.asarray(at.point.kept[name]) for name in names])
    slopes = np.concatenate([np.asarray(at.kept_slopes[name]) for name in names])
    count = slopes.shape[1]
    box = np.vstack([np.eye(count), -np.eye(count)])
    h, g = np.asarray(at.curvature), np.asarray(at.slope)
    # what has no slope (a margin that is not there, or that an unstable loop cannot have) is nothing to steer by
    known = np.isfinite(values) & np.isfinite(slopes).all(axis=1) & (slopes != 0.0).any(axis=1)
    for share in RELAXATIONS:
        room = np.where(values > 0, (1.0 - share) * values, 0.0) - values
        rows = np.vstack([slopes[known], box])
        ends = np.r_[room[known], np.full(2 * count, radius)]
        owners = np.r_[np.flatnonzero(known), np.full(2 * count, -1)]
        solved = quadratic_program(h, g, rows, ends)
        for _ in range(MAX_CUTS):
            if solved is None:
                break
            cuts, limits, owned = _cuts(at, names, solved.d, values + room)
            if not len(owned):
                break
            rows, ends, owners = np.vstack([rows, cuts]), np.r_[ends, limits], np.r_[owners, owned]
            solved = quadratic_program(h, g, rows, ends)
        if solved is not None:
            break
    else:
        raise AssertionError("no step at all always keeps what is kept")
    prices = np.zeros(len(values))
    np.add.at(prices, owners[owners >= 0], solved.multipliers[owners >= 0])
    firsts = np.cumsum([len(at.point.kept[name]) for name in names])[:-1]
    return np.clip(solved.d, -radius, radius), dict(zip(names, np.split(prices, firsts), strict=True))


def _rms_model(at: LinearisedPoint, name: str, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A limited RMS after the step `d`, were its signal linear in d, and the slopes there; convex in d."""
    products, step = np.asarray(at.products[name]), np.r_[1.0, d]
    along = products @ step
    root = np.sqrt(np.maximum(along @ step, 1e-300))
    return root - 1.0, along[:, 1:] / root[:, None]


def _cuts(
    at: LinearisedPoint, names: list[str], d: np.ndarray, allowed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes that keep the next step from where a limited RMS bends beyond what is allowed at `d`."""
    rows, ends, owners, first = [np.zeros((0, len(d)))], [], [], 0
    for name in names:
        count = len(at.point.kept[name])
        if name in at.products:
            value, slope = _rms_model(at, name, d)
            over = np.flatnonzero(value > allowed[first : first + count] + CUT_TOLERANCE)
            rows.append(slope[over])
            ends += list(allowed[first + over] - value[over] + slope[over] @ d)
            owners += list(first + over)
        first += count
    return np.vstack(rows), np.array(ends), np.array(owners, int)


def _predicted_merit(at: LinearisedPoint, d: np.ndarray, price: float) -> float:
    """The merit after the step `d`, as the quadratic and the lines have it."""
    h, g = np.asarray(at.curvature), np.asarray(at.slope)
    missed = 0.0
    for name, values in at.point.kept.items():
        straight = np.asarray(values) + np.asarray(at.kept_slopes[name]) @ d
        missed += max(0.0, float(np.max(_rms_model(at, name, d)[0] if name in at.products else straight)))
    return float(at.point.objective) + float(g @ d + 0.5 * d @ h @ d) + price * missed
