"""Search and filter in turn until neither changes the other, then once more with finer steps of the integrator."""

import dataclasses
import itertools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jaxtyping import Array, Float

from diffdrive.parameters import as_arrays
from tuning.filtering import likeliest, track
from tuning.fit import FINEST_SUBSTEP, Innovations, Problem, sampling_of
from tuning.least_squares import Progress, Search, levenberg_marquardt
from tuning.prediction import Predicted
from tuning.question import placed, value
from tuning.uncertainty import Covariance, sandwich

MOST_STEPS = 15  # of each search
MOST_ROUNDS = 12  # of filtering and searching
SETTLED = 0.1  # standard errors; a round that moves no parameter further is the last
TOLERANCE = 1e-6
SMOOTHING = 0.02  # s


class Fit(NamedTuple):
    """A refined fit: the last search, the gains it went by, and what it leaves."""

    residuals: Innovations
    problem: Problem
    search: Search
    covariance: Covariance
    innovation: Float[np.ndarray, "lanes n"]  # m; zero where nothing was measured
    velocity: Float[np.ndarray, "lanes n"]  # m/s
    process: float = np.inf  # N
    gain: float = 0.0  # in deviance, of that process over none
    steps: int = 0


def refined(fine: Innovations, y: Float[np.ndarray, " k"], problem: Problem, noise: float, progress: Progress) -> Fit:
    """Search and filter in turn, until the filter's gains no longer change what is found."""
    steps, process = 0, np.inf
    for _ in range(MOST_ROUNDS):
        drive, unknowns = fine.unpack(jnp.asarray(y), problem)
        before = process
        process, gain, filtered = likeliest(drive, unknowns.delay, noise, problem.lanes, fine.sampling)
        problem = problem._replace(gains=jax.tree.map(np.asarray, filtered.gains))
        fit = searched(fine, y, problem, progress)
        errors = np.sqrt(np.diag(fit.covariance.matrix))
        settled = process == before and np.max(np.abs(fit.search.y - y) / errors) < SETTLED
        y, steps = fit.search.y, steps + fit.search.steps
        if settled and fit.search.status == "converged":
            break
    return fit._replace(process=process, gain=gain, steps=steps)


def searched(fine: Innovations, y: Float[np.ndarray, " k"], problem: Problem, progress: Progress) -> Fit:
    """One search under given gains."""
    given = as_arrays(problem)
    search = levenberg_marquardt(fine, y, given, max_steps=MOST_STEPS, tolerance=TOLERANCE, progress=progress)
    predicted, covariance = _predict(fine, jnp.asarray(search.y), given), _covariance(fine, search.y, problem)
    innovation = np.asarray(predicted.innovation) * np.asarray(problem.lanes.counts)
    return Fit(fine, problem, search, covariance, innovation, np.asarray(predicted.velocity))


def sharpened(fit: Fit, noise: float, progress: Progress) -> Fit:
    """The fit at a quarter of the substep, and what the integrator's error may still be, added to its covariance.

    The integrator is of second order, so a sixteenth of its error is left, a fifteenth of how far the estimates moved.
    """
    finest = dataclasses.replace(fit.residuals, sampling=sampling_of(fit.residuals.sampling.rate, FINEST_SUBSTEP))
    drive, unknowns = finest.unpack(jnp.asarray(fit.search.y), fit.problem)
    filtered = track(drive, unknowns.delay, fit.process, noise, fit.problem.lanes, finest.sampling)
    problem = fit.problem._replace(gains=jax.tree.map(np.asarray, filtered.gains))
    sharp = searched(finest, fit.search.y, problem, progress)
    left = (sharp.search.y - fit.search.y) / 15.0
    covariance = sharp.covariance._replace(matrix=sharp.covariance.matrix + np.outer(left, left))
    return sharp._replace(
        covariance=covariance, process=fit.process, gain=fit.gain, steps=fit.steps + sharp.search.steps
    )


@eqx.filter_jit
def _predict(fine: Innovations, y: Float[Array, " k"], problem: Problem) -> Predicted:
    return fine.predict(y, problem)


@eqx.filter_jit
def linearised(fine: Innovations, y: Float[Array, " k"], problem: Problem) -> Any:
    """The residuals at y, [m], and their derivative, [m, k]."""

    def along(direction: Float[Array, " k"]) -> Any:
        return jax.jvp(lambda y: fine(y, problem), (y,), (direction,))

    return jax.vmap(along, out_axes=(None, 1))(jnp.eye(len(y)))


def _covariance(fine: Innovations, y: Float[np.ndarray, " k"], problem: Problem) -> Covariance:
    shape = problem.lanes.position.shape
    value, slope = (np.asarray(one) for one in linearised(fine, jnp.asarray(y), as_arrays(problem)))
    samples = shape[0] * shape[1]
    return sandwich(value[:samples].reshape(shape), slope[:samples].reshape(*shape, -1), fine.sampling.rate)


def narrowed(fit: Fit, lost: set[str]) -> tuple[Innovations, Float[np.ndarray, " k"], Problem]:
    """The problem without the parameters in `lost`, which go back to what was believed, and y of the others."""
    free, problem = fit.residuals.free, fit.problem
    kept = np.array([one.path not in lost for one in free])
    unknowns = problem.unknowns
    for path in sorted(lost):
        unknowns = placed(unknowns, path, value(problem.believed_unknowns, path))
    smaller = dataclasses.replace(fit.residuals, free=tuple(itertools.compress(free, kept)))
    return smaller, fit.search.y[kept], problem._replace(unknowns=unknowns, origin=np.asarray(problem.origin)[kept])


def missing_force(fit: Fit) -> Float[np.ndarray, "lanes n"]:
    """The force (N) that the filter's corrections of the velocity stand for, averaged over `SMOOTHING`."""
    drive, _ = fit.residuals.unpack(jnp.asarray(fit.search.y), fit.problem)
    sampling = fit.residuals.sampling
    force = float(drive.plant.mass) * sampling.rate * np.asarray(fit.problem.gains.velocity) * fit.innovation
    width = max(1, round(SMOOTHING * sampling.rate))
    return scipy.ndimage.uniform_filter1d(force, width, axis=1)


def friction_of(fit: Fit) -> float:
    """Coulomb friction (N) at no load, the scale against which missing forces count."""
    unknowns = fit.residuals.unpack(jnp.asarray(fit.search.y), fit.problem)[1]
    return 0.5 * float(unknowns.coulomb.positive + unknowns.coulomb.negative)
