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

FIRST_RADIUS, LARGEST_RADIUS, SMALLEST_RADIUS = 0.5, 2.0, 1e-3  # units of theta
ACCEPTED_RATIO, GOOD_RATIO = 0.05, 0.7  # share of the predicted gain
FEASIBILITY_TOLERANCE = 5e-3  # a requirement missed by less counts as kept
MIN_GAIN = 1e-3  # of the objective, that a step must foretell, and three have gained, to be worth going on
STALLED_STEPS = 3
MAX_CUTS, CUT_TOLERANCE = 12, 1e-4  # at most, and how far a requirement may bend beyond its line
PENALTY_FACTOR = 2.0  # of a missed requirement, over its multiplier
RELAXATIONS = (1.0, 0.5, 0.25, 0.0)  # share of what is missed that one step is to restore


@dataclass(frozen=True)
class SearchState:
    """Where a search stands after a step: all that it needs to go on, and numbers alone."""

    theta: tuple[float, ...]
    radius: float = FIRST_RADIUS
    penalty: float = 0.0
    steps: int = 0
    evaluations: int = 0  # of the objective, forward
    linearisations: int = 0  # with derivatives
    seconds: float = 0.0
    history: tuple[tuple[int, int, float, float, float], ...] = ()  # evaluations, linearisations, s, objective, missed
    status: str = "running"
    best: tuple[float, ...] | None = None  # theta of the lowest objective with every requirement kept
    best_objective: float = np.inf

    @property
    def interrupted(self) -> bool:
        """Whether somebody stopped it."""
        return self.status.startswith("interrupted")

    @property
    def infeasible(self) -> bool:
        """Whether it ended where no step comes nearer to what is required."""
        return self.status.startswith("infeasible")


@dataclass(frozen=True)
class SearchResult:
    """The end of a search: the point, its worth, and the price of each requirement there."""

    state: SearchState
    linearised: LinearisedPoint
    multipliers: dict[str, Float[np.ndarray, " n"]]

    @property
    def theta(self) -> Float[np.ndarray, " k"]:
        """The point."""
        return np.array(self.state.theta)


def search(
    gains: ConstrainedGains,
    problem: TuningProblem,
    start: SearchState,
    *,
    max_steps: int = 40,
    progress: StepProgress = no_progress,
    keep: Callable[[SearchState], None] = lambda _: None,
) -> SearchResult:
    """Search on from `start` until no step gains, `max_steps`, or Ctrl-C; `keep` gets the state after each step.

    A search that goes on from such a state takes the same steps as if it had not been stopped.
    """
    state, started = start, time.perf_counter() - start.seconds
    linearised = _linearised(gains, problem, state)
    try:
        while state.status == "running":
            state, linearised = (_step if is_simulable(linearised.point) else _stabilise)(
                gains, problem, state, linearised
            )
            state = dataclasses.replace(state, seconds=time.perf_counter() - started)
            entry = (
                state.evaluations,
                state.linearisations,
                state.seconds,
                *_objective_and_violation(linearised.point),
            )
            state = dataclasses.replace(state, history=(*state.history, entry))
            if entry[4] <= FEASIBILITY_TOLERANCE and entry[3] < state.best_objective:
                state = dataclasses.replace(state, best=state.theta, best_objective=entry[3])
            if state.status == "running" and _stalled(state.history):
                state = dataclasses.replace(state, status="converged")
            if state.status == "running" and state.steps >= max_steps:
                state = dataclasses.replace(state, status=f"stopped after {max_steps} steps")
            keep(state)
            progress(state.steps, max_steps, entry[3])
    except KeyboardInterrupt:
        state = dataclasses.replace(state, status=f"interrupted after {state.steps} steps")
    violation = _objective_and_violation(linearised.point)[1] > FEASIBILITY_TOLERANCE
    if violation and state.best is not None:  # stopped on the way
        state = dataclasses.replace(state, theta=state.best)
        linearised = _linearised(gains, problem, state)
    elif violation and state.status == "converged":
        state = dataclasses.replace(state, status="infeasible: no step brings it nearer to what is required")
    multipliers = (
        _solve_subproblem(linearised, max(state.radius, SMALLEST_RADIUS))[1] if is_simulable(linearised.point) else {}
    )
    return SearchResult(state, linearised, multipliers)


def _stalled(history: tuple[tuple[int, int, float, float, float], ...]) -> bool:
    """Whether the last points that were taken, all within the requirements, gained next to nothing."""
    taken = [entry for before, entry in itertools.pairwise(history) if entry[1] > before[1]]
    if len(taken) <= STALLED_STEPS or max(entry[4] for entry in taken[-1 - STALLED_STEPS :]) > FEASIBILITY_TOLERANCE:
        return False
    return taken[-1 - STALLED_STEPS][3] - taken[-1][3] < MIN_GAIN * taken[-1][3]


def _linearised(gains: ConstrainedGains, problem: TuningProblem, state: SearchState) -> LinearisedPoint:
    return linearise_at(gains, jnp.asarray(state.theta), problem)


def _objective_and_violation(point: DesignPoint) -> tuple[float, float]:
    return float(point.objective), float(point.violation)


def _merit(point: DesignPoint, penalty: float) -> float:
    """Objective and the price of what is missed; infinite where the loop diverges."""
    violation = sum(max(0.0, float(jnp.max(values))) for values in point.constraints.values())
    merit = float(point.objective) + penalty * violation
    return merit if np.isfinite(merit) else np.inf


def _stabilise(
    gains: ConstrainedGains, problem: TuningProblem, state: SearchState, linearised: LinearisedPoint
) -> tuple[SearchState, LinearisedPoint]:
    """One step of an unstable loop towards a stable one, whatever it does to the objective."""
    d = stabilising_step(linearised, state.radius)
    state = dataclasses.replace(state, steps=state.steps + 1)
    if d is None:
        return dataclasses.replace(state, status="unstable: nothing near these gains is stable"), linearised
    new_theta = tuple(float(value) for value in np.array(state.theta) + d)
    trial_point = evaluate(gains, jnp.asarray(new_theta), problem)
    state = dataclasses.replace(state, evaluations=state.evaluations + 1)
    if not float(jnp.max(trial_point.constraints["stability"])) < float(
        jnp.max(linearised.point.constraints["stability"])
    ):
        radius = 0.3 * min(state.radius, float(np.max(np.abs(d))))
        status = "running" if radius > SMALLEST_RADIUS else "unstable: no step from here makes the loop more stable"
        return dataclasses.replace(state, radius=radius, status=status), linearised
    state = dataclasses.replace(state, theta=new_theta, linearisations=state.linearisations + 1)
    linearised = _linearised(gains, problem, state)
    return dataclasses.replace(
        state, radius=FIRST_RADIUS if is_simulable(linearised.point) else LARGEST_RADIUS
    ), linearised


def _step(
    gains: ConstrainedGains, problem: TuningProblem, state: SearchState, linearised: LinearisedPoint
) -> tuple[SearchState, LinearisedPoint]:
    """One quadratic program and the trial of its answer."""
    d, multipliers = _solve_subproblem(linearised, state.radius)
    largest = max(float(np.sum(values)) for values in multipliers.values())
    penalty = max(state.penalty, PENALTY_FACTOR * largest, float(linearised.point.objective))
    gain = _merit(linearised.point, penalty) - _predicted_merit(linearised, d, penalty)
    state = dataclasses.replace(state, penalty=penalty, steps=state.steps + 1)
    if gain < MIN_GAIN * float(linearised.point.objective):
        return dataclasses.replace(state, status="converged"), linearised
    trial = jnp.asarray(np.array(state.theta) + d)
    trial_point = evaluate(gains, trial, problem)
    state = dataclasses.replace(state, evaluations=state.evaluations + 1)
    ratio = (_merit(linearised.point, penalty) - _merit(trial_point, penalty)) / gain
    longest = float(np.max(np.abs(d)))
    if not ratio > ACCEPTED_RATIO:
        radius = 0.3 * min(state.radius, longest)
        return dataclasses.replace(state, radius=radius, status=_trust_region_status(radius)), linearised
    radius = (
        min(LARGEST_RADIUS, 2.0 * state.radius) if ratio > GOOD_RATIO and longest > 0.9 * state.radius else state.radius
    )
    new_theta = tuple(float(value) for value in trial)
    state = dataclasses.replace(state, theta=new_theta, radius=radius, linearisations=state.linearisations + 1)
    return state, _linearised(gains, problem, state)


def _trust_region_status(radius: float) -> str:
    return "running" if radius > SMALLEST_RADIUS else "converged"


def _solve_subproblem(linearised: LinearisedPoint, radius: float) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The step within the radius that keeps the requirements, or restores as large a share of them as it can."""
    names = list(linearised.point.constraints)
    values = np.concatenate([np.asarray(linearised.point.constraints[name]) for name in names])
    slopes = np.concatenate([np.asarray(linearised.constraint_jacobians[name]) for name in names])
    count = slopes.shape[1]
    box = np.vstack([np.eye(count), -np.eye(count)])
    h, g = np.asarray(linearised.hessian), np.asarray(linearised.gradient)
    # what has no slope (a margin that is not there, or that an unstable loop cannot have) is nothing to steer by
    known = np.isfinite(values) & np.isfinite(slopes).all(axis=1) & (slopes != 0.0).any(axis=1)
    for share in RELAXATIONS:
        room = np.where(values > 0, (1.0 - share) * values, 0.0) - values
        rows = np.vstack([slopes[known], box])
        ends = np.r_[room[known], np.full(2 * count, radius)]
        owners = np.r_[np.flatnonzero(known), np.full(2 * count, -1)]
        solution = quadratic_program(h, g, rows, ends)
        for _ in range(MAX_CUTS):
            if solution is None:
                break
            cuts, limits, cut_owners = _cuts(linearised, names, solution.d, values + room)
            if not len(cut_owners):
                break
            rows, ends, owners = np.vstack([rows, cuts]), np.r_[ends, limits], np.r_[owners, cut_owners]
            solution = quadratic_program(h, g, rows, ends)
        if solution is not None:
            break
    else:
        raise AssertionError("no step at all always keeps what is kept")
    multipliers = np.zeros(len(values))
    np.add.at(multipliers, owners[owners >= 0], solution.multipliers[owners >= 0])
    firsts = np.cumsum([len(linearised.point.constraints[name]) for name in names])[:-1]
    return np.clip(solution.d, -radius, radius), dict(zip(names, np.split(multipliers, firsts), strict=True))


def _rms_model(linearised: LinearisedPoint, name: str, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A limited RMS after the step `d`, were its signal linear in d, and the slopes there; convex in d."""
    products, step = np.asarray(linearised.products[name]), np.r_[1.0, d]
    along = products @ step
    root = np.sqrt(np.maximum(along @ step, 1e-300))
    return root - 1.0, along[:, 1:] / root[:, None]


def _cuts(
    linearised: LinearisedPoint, names: list[str], d: np.ndarray, allowed: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes that keep the next step from where a limited RMS bends beyond what is allowed at `d`."""
    rows, ends, owners, first = [np.zeros((0, len(d)))], [], [], 0
    for name in names:
        count = len(linearised.point.constraints[name])
        if name in linearised.products:
            value, slope = _rms_model(linearised, name, d)
            over = np.flatnonzero(value > allowed[first : first + count] + CUT_TOLERANCE)
            rows.append(slope[over])
            ends += list(allowed[first + over] - value[over] + slope[over] @ d)
            owners += list(first + over)
        first += count
    return np.vstack(rows), np.array(ends), np.array(owners, int)


def _predicted_merit(linearised: LinearisedPoint, d: np.ndarray, penalty: float) -> float:
    """The merit after the step `d`, as the quadratic and the lines have it."""
    h, g = np.asarray(linearised.hessian), np.asarray(linearised.gradient)
    violation = 0.0
    for name, values in linearised.point.constraints.items():
        straight = np.asarray(values) + np.asarray(linearised.constraint_jacobians[name]) @ d
        violation += max(
            0.0, float(np.max(_rms_model(linearised, name, d)[0] if name in linearised.products else straight))
        )
    return float(linearised.point.objective) + float(g @ d + 0.5 * d @ h @ d) + penalty * violation
