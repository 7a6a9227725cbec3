"""Fit by the simulation error in closed loop: the commands of a replay against the commands of the logs.

Only its controller corrects the simulation, so this fit weighs the errors of the force over whole strokes, where the
prediction error of `tuning.identification.identify` weighs those from one sample to the next. With an
exact model both find the same drive, the latter more sharply; with a real one this says how close the model's force can
come.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Drive, Sampling, check_drive
from diffdrive.model.quantity import check
from diffdrive.numerics.arrays import Scalar, as_arrays, require_double_precision
from diffdrive.support.rates import is_same_rate
from tuning.identification import inverse_dynamics
from tuning.identification.inverse_dynamics import LOAD_SPREAD, MIN_SPEED
from tuning.identification.parameters import FIXABLE, parameter_called
from tuning.identification.problem import FINE_SUBSTEP, sampling_of
from tuning.identification.ranges import clipped_start
from tuning.identification.regressors import DIRECTIONAL
from tuning.identification.replay import ReplayInputs, replay, replay_inputs
from tuning.identification.seed import initial_drive
from tuning.identification.unknowns import Unknowns, default_bounds, free_paths, unknowns_of, value_at, with_value
from tuning.optimisation.least_squares import LeastSquaresResult, StepProgress, levenberg_marquardt, no_progress
from tuning.optimisation.space import FreeParameter, SearchSpace, search_space

MAX_STEPS = 25
TOLERANCE = 1e-3
PRIOR_WEIGHT = 1e-2  # percent per unit of theta: parameters that the force does not determine stay at their start


class ReplayProblem(NamedTuple):
    """The model, its start, and the logs that it is fitted to."""

    nominal: Drive
    controller: Controller
    unknowns: Unknowns  # where the search starts
    given: ReplayInputs
    norm: Scalar  # N, of the logged force over all samples
    origin: Float[Array, " free"] | Float[np.ndarray, " free"]  # of the search space


@dataclasses.dataclass(frozen=True)
class CommandResiduals:
    """Residuals of a `ReplayProblem` as a function of theta; hashed by value, so that each problem is compiled once.

    Simulated minus logged command in percent of the norm of the logged force: the root of their sum of squares is the
    `force_percent` of `tuning.identification.replay`. Then the weakly weighted distance of theta from its start.
    """

    free: tuple[FreeParameter, ...]
    sampling: Sampling

    def drive(self, theta: Float[Array, " k"], problem: ReplayProblem) -> Drive:
        """The drive at y."""
        unknowns = SearchSpace(self.free, problem.origin).insert(problem.unknowns, theta)
        drive = unknowns.drive(problem.nominal)
        actuator = dataclasses.replace(drive.actuator, delay_fraction=unknowns.delay - drive.actuator.delay_samples)
        return dataclasses.replace(drive, actuator=actuator)

    def __call__(self, theta: Float[Array, " k"], problem: ReplayProblem) -> Float[Array, " m"]:
        lanes = problem.given.lanes
        command = replay(self.drive(theta, problem), problem.controller, problem.given, self.sampling).command
        difference = jnp.where(lanes.counts > 0, command - lanes.command, 0.0)
        return jnp.concatenate([(100.0 / problem.norm * difference).ravel(), PRIOR_WEIGHT * theta])


def fit_closed_loop(
    logs: Sequence[Log],
    drive: Drive,
    controller: Controller,
    start: Drive | None = None,
    *,
    fixed: Sequence[str] = (),
    max_steps: int = MAX_STEPS,
    progress: StepProgress = no_progress,
) -> tuple[Drive, LeastSquaresResult]:
    """Fit `drive` to the commands of `logs` (of one machine, at one rate) in closed loop through `controller`.

    The search starts from `start`, by default from `drive` with what inverse dynamics finds; it has no other starts, so
    a result of identification is the safer one. `fixed` names parameters (as in the drive file) that stay as it has
    them. The delay is free within the period that `delay_samples` of `drive` begins. The search's costs are in percent
    of the logged force.

    Raises `LogError` and `ParameterError` as `tuning.identification.replay` does, the latter for an unknown name too,
    and `DivergenceError` where the start runs away.
    """
    require_double_precision()
    check(controller)
    check_drive(drive)
    if not logs or any(not is_same_rate(log.rate, logs[0].rate) for log in logs):
        raise LogError("give one log or more, all of one rate")
    held = {parameter_called(name, FIXABLE, f"cannot fix '{name}'").unknown for name in fixed}
    if start is None:
        start, _ = initial_drive(drive, inverse_dynamics.identify(list(logs), DIRECTIONAL, min_speed=MIN_SPEED))
    check_drive(start)
    pieces = replay_inputs(list(logs))
    unknowns, free = _free_parameters(start, drive.actuator.delay_samples, pieces, held)
    lanes = pieces.lanes
    # of a limit, a quantiser or an estimator's gate the search sees the smooth neighbour
    believed, smoothed = smooth((dataclasses.replace(start, actuator=drive.actuator, sensor=drive.sensor), controller))
    problem = ReplayProblem(
        nominal=believed,
        controller=smoothed,
        unknowns=unknowns,
        given=pieces,
        norm=jnp.linalg.norm(lanes.counts * (lanes.command + lanes.disturbance)),
        origin=search_space(unknowns, free).origin,
    )
    residuals = CommandResiduals(free, sampling_of(float(round(logs[0].rate, 6)), FINE_SUBSTEP))
    arrays = as_arrays(problem)
    search = levenberg_marquardt(
        residuals, np.zeros(len(free)), arrays, max_steps=max_steps, tolerance=TOLERANCE, progress=progress
    )
    fitted = jax.tree.map(float, residuals.drive(jnp.asarray(search.theta), arrays))
    # the limits and the scale as they are, not their smooth neighbours
    actuator = dataclasses.replace(drive.actuator, delay_fraction=fitted.actuator.delay_fraction)
    return dataclasses.replace(fitted, actuator=actuator, sensor=drive.sensor), search


def _free_parameters(
    start: Drive, delay_samples: int, pieces: ReplayInputs, fixed: set[str]
) -> tuple[Unknowns, tuple[FreeParameter, ...]]:
    """The unknowns at `start`, those that are not held nudged inside their bounds, and these."""
    actuator = start.actuator
    unknowns = unknowns_of(start, actuator.delay_samples + float(actuator.delay_fraction or 0.0))
    load = np.asarray(pieces.lanes.load)[np.asarray(pieces.lanes.counts) > 0]
    if np.ptp(load) <= LOAD_SPREAD * np.max(np.abs(load)):
        fixed = fixed | {"load_coefficient"}
    if "breakaway" in fixed:  # a held gap stays a gap, whatever becomes of the Coulomb friction
        unknowns = dataclasses.replace(unknowns, breakaway=None)
    free = []
    for path in free_paths(unknowns):
        if path.split(".")[0] in fixed:
            continue
        initial = value_at(unknowns, path)
        limits = (
            FreeParameter(path, delay_samples, delay_samples + 1.0)
            if path == "delay"
            else default_bounds(path, initial, _coulomb(unknowns))
        )
        unknowns = with_value(unknowns, path, clipped_start(initial, limits))
        free.append(limits)
    return unknowns, tuple(free)


def _coulomb(unknowns: Unknowns) -> float:
    return 0.5 * float(unknowns.coulomb.positive + unknowns.coulomb.negative)
