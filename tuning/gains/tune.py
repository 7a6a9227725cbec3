"""The auto-tuner: gains by gradient over an ensemble of scenarios, within stability margins and other requirements.

starts -> unstable ones made stable, side by side -> searched, the most promising first -> the best
"""

import functools
import time
from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from diffdrive.controllers import Controller, FrictionCompensation
from diffdrive.errors import ParameterError
from diffdrive.loop.smooth import smooth
from diffdrive.model.quantity import check, quantities
from diffdrive.numerics.arrays import as_arrays, require_double_precision
from diffdrive.support.bounds import require_count
from diffdrive.support.resources import format_count, require_memory
from tuning.gains.checkpoint import Checkpoint
from tuning.gains.constrained import ConstrainedGains, DesignPoint, evaluate, tuning_problem
from tuning.gains.objective import Objective
from tuning.gains.requirements import Constraints
from tuning.gains.scenarios import Ensemble
from tuning.gains.sequential import FEASIBILITY_TOLERANCE, SearchResult, SearchState, search
from tuning.optimisation.least_squares import StepProgress, no_progress
from tuning.optimisation.space import SearchSpace, space_around

FRICTION_FACTOR = 1.5  # of the observer's friction parameters, when these are tuned along
STARTS, MAX_STEPS = 4, 40
START_STD = 1.0  # units of theta
BYTES_PER_START = 1e4  # bytes: what is known of a start before any is searched from
TOLERATED_LOSS = 0.05  # share of the objective
MAX_TOLERANCE = 1e3  # what is said of a gain that may move as far as it likes


def default_space(controller: Controller, *, friction: bool = False) -> SearchSpace:
    """The gains that this kind of controller is tuned by, those that are zero left out: they stay."""
    return space_around(controller, gain_factors(controller, friction=friction))


def gain_factors(controller: Controller, *, friction: bool = False) -> dict[str, float]:
    """The gains of this kind of controller, and by what factor each may move from where it is.

    `friction` frees the friction parameters that an observer believes in as well, in each direction.
    """
    factors = {gain.path: gain.factor for gain in controller.tunables.values()}
    if friction and isinstance(controller, FrictionCompensation):
        factors |= {
            f"{name}.{side}": FRICTION_FACTOR
            for name, declared, _ in quantities(controller.observer.friction, "observer.friction")
            if declared.directional
            for side in ("positive", "negative")
        }
    return factors


def gain_names(controller: Controller, space: SearchSpace) -> dict[str, str]:
    """What a controller calls the parameters of its space, by their paths; friction by the last parts of its path."""
    names = {gain.path: name for name, gain in controller.tunables.items()}
    return {free.path: names.get(free.path, short) for free, short in zip(space.free, space.names, strict=True)}


def gain_units(controller: Controller, space: SearchSpace) -> list[str]:
    """The units of the parameters of its space, as they are declared."""
    units = {path: declared.unit for path, declared, _ in quantities(controller)}
    return [units[parameter.quantity] for parameter in space.free]


@dataclass(frozen=True)
class SearchOptions:
    """How much is searched; raises `ParameterError` for no start, no step, or more starts than fit into memory."""

    starts: int = STARTS  # the gains as given, and points drawn about them
    seed: int = 0  # of these points
    max_steps: int = MAX_STEPS  # of the search from each

    def __post_init__(self) -> None:
        require_count("starts", self.starts)
        require_count("seed", self.seed, at_least=0)
        require_count("max_steps", self.max_steps)
        needed = BYTES_PER_START * self.starts
        require_memory(ParameterError, f"{format_count(self.starts)} starts", needed, "give fewer")


@dataclass(frozen=True)
class BindingRequirement:
    """A requirement that holds the objective back: what a relaxation of 1 % would gain, in percent of the objective."""

    name: str
    gain: float


@dataclass(frozen=True)
class GainSearch:
    """The tuned controller, each gain before and after, and what stood in the way of better ones."""

    controller: Controller
    names: list[str]  # a gain's own; of a friction parameter the last parts of its path
    units: list[str]
    before: Float[np.ndarray, " k"]
    after: Float[np.ndarray, " k"]
    at_bound: list[str]
    point: DesignPoint  # the objective, and every requirement
    initial_point: DesignPoint  # the same where the controller was given
    binding: list[BindingRequirement]
    tolerance: Float[np.ndarray, " k"]  # factor by which each alone may move for 5 % more of the objective; 1000: any
    best: SearchResult
    searches: list[SearchResult]  # one from each start, in the order in which they were made
    start_objectives: Float[
        np.ndarray, " s"
    ]  # objective where each start ended; infinite where it kept not what is required
    screening_seconds: float  # s, in which the starts were looked at

    @property
    def status(self) -> str:
        """Why the search ended; whether the requirements are kept is `feasible`."""
        return self.best.state.status

    @property
    def interrupted(self) -> bool:
        """Whether somebody stopped it."""
        return self.best.state.interrupted

    @property
    def feasible(self) -> bool:
        """Whether every requirement is kept."""
        return bool(self.point.violation <= FEASIBILITY_TOLERANCE)

    @property
    def violated(self) -> dict[str, float]:
        """The requirements that are not kept, and by which share."""
        return {
            name: float(jnp.max(v))
            for name, v in self.point.constraints.items()
            if not float(jnp.max(v)) <= FEASIBILITY_TOLERANCE
        }


def tune(
    controller: Controller,
    scenarios: Ensemble,
    requirements: Constraints,
    space: SearchSpace | None = None,
    *,
    objective: Objective = Objective(),
    options: SearchOptions = SearchOptions(),
    resume: str | Path | None = None,
    progress: StepProgress = no_progress,
) -> GainSearch:
    """Tune `controller` over `scenarios` within `requirements`; verify the result on the exact simulator.

    The first start is the controller as given, the others are drawn about it: the landscape has several valleys of
    nearly the same depth (docs/method/tuning.md). An unstable start first goes to where the loop is stable. From the
    folder `resume` the search goes on there where it was stopped, by a kill or by Ctrl-C, and takes the same steps as
    if it had not been. Raises `ParameterError` for parameters out of bounds and `CheckpointError` for a folder with the
    checkpoint of another problem.
    """
    require_double_precision()
    check(controller)
    space = default_space(controller) if space is None else space
    gains = ConstrainedGains(space.free, objective)
    problem = tuning_problem(as_arrays(smooth(controller)), space, scenarios, requirements)
    points = _start_points(len(space.free), options)
    checkpoint = Checkpoint(resume, (space, problem, objective, points))
    started = time.perf_counter()
    start_points = [
        jax.block_until_ready(evaluate(gains, jnp.asarray(point), problem))  # type: ignore[no-untyped-call]
        for point in points
    ]
    screening = time.perf_counter() - started
    order = np.argsort([float(point.penalised_objective) for point in start_points])
    results: list[SearchResult] = []
    objectives = np.full(options.starts, np.inf)
    for k in order:
        start = checkpoint.state_of(int(k)) or SearchState(tuple(float(value) for value in points[k]))
        result = search(
            gains,
            problem,
            start,
            max_steps=options.max_steps,
            progress=progress,
            keep=functools.partial(checkpoint.save, int(k)),
        )
        results.append(result)
        objectives[k] = (
            float(result.linearised.point.objective)
            if result.linearised.point.violation <= FEASIBILITY_TOLERANCE
            else np.inf
        )
        if result.state.interrupted:
            break
    best = min(results, key=lambda result: float(result.linearised.point.penalised_objective))
    return _gain_search(controller, space, best, start_points[0], results, objectives, screening)


def _start_points(count: int, options: SearchOptions) -> Float[np.ndarray, "s k"]:
    others = START_STD * np.random.default_rng(options.seed).normal(size=(options.starts - 1, count))
    return np.vstack([np.zeros((1, count)), others])


def _gain_search(
    controller: Controller, space: SearchSpace, result: SearchResult, initial_point: DesignPoint,
    searches: list[SearchResult], objectives: Float[np.ndarray, " s"], screening: float,
) -> GainSearch:  # fmt: skip
    objective = float(result.linearised.point.objective)
    binding = [
        BindingRequirement(name, float(np.sum(prices)) / objective)
        for name, prices in result.multipliers.items()
        if float(np.sum(prices)) > 1e-3 * objective
    ]
    names = gain_names(controller, space)
    values = np.asarray(space.values(result.theta))
    # a step of theta that moves the logarithm of each value by one, and how far that goes for a share of the objective
    per_log = 1.0 / np.diag(
        np.asarray(jax.jacobian(lambda theta: jnp.log(space.values(theta)))(jnp.asarray(result.theta)))
    )
    curvature = np.diag(np.asarray(result.linearised.hessian)) * per_log**2
    reach = np.sqrt(2.0 * TOLERATED_LOSS * objective / np.maximum(curvature, 1e-300))
    return GainSearch(
        controller=jax.tree.map(float, space.insert(as_arrays(controller), result.theta)),
        names=list(names.values()),
        units=gain_units(controller, space),
        before=np.asarray(space.values(np.zeros_like(result.theta))),
        after=values,
        at_bound=[names[path] for path in space.near_bound(result.theta)],
        point=result.linearised.point,
        initial_point=initial_point,
        binding=sorted(binding, key=lambda requirement: -requirement.gain),
        tolerance=np.exp(np.minimum(reach, np.log(MAX_TOLERANCE))),
        best=result,
        searches=searches,
        start_objectives=objectives,
        screening_seconds=screening,
    )
