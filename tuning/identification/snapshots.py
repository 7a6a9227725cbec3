"""Whether the rows of a log are every sample of the control, or snapshots of a faster loop, as the fits show it."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.special import expit, logit

from diffdrive.numerics.arrays import as_arrays
from tuning.identification.adequacy import DEVIANCE
from tuning.identification.command_noise import without_noise
from tuning.identification.prediction import Lanes
from tuning.identification.problem import IdentificationProblem
from tuning.identification.refinement import RefinedFit, evaluated, refine, was_interrupted
from tuning.identification.row_force import BetweenRows
from tuning.optimisation.least_squares import StepProgress
from tuning.store.store import Store

HALF_A_ROW = 0.5  # by which a held command acts later on average than that of its own instant
LATEST = 0.98  # of the range of the delay, where a start still has a gradient


def as_read(lanes: Lanes, between: BetweenRows) -> Lanes:
    """The lanes with their command as it acts: that of snapshots without the noise of its loop."""
    if between is BetweenRows.HELD:
        return lanes
    command = without_noise(np.asarray(lanes.command), np.asarray(lanes.counts))
    return lanes._replace(command=jnp.asarray(command))


def as_rows_show(
    held: RefinedFit, problem: IdentificationProblem, noise: float, progress: StepProgress, store: Store | None
) -> RefinedFit:
    """The fit of a command that is held between rows, or of a smooth one where the rows are snapshots.

    They are where a held command would act before it was given. Or else where the smooth command, as noisy as it was
    logged, is the likelier: both have the same parameters. Where the held command leaves no force missing, nothing else
    is tried. `problem` is the one that the fit began with.
    """
    if was_interrupted(held.search) or not held.deviance_gain > DEVIANCE:
        return held
    residuals = dataclasses.replace(held.residuals, between=BetweenRows.SMOOTH)
    start, steps = on_smooth_command(held.search.theta, held, problem), held.steps
    if not _acts_early(held, problem):
        noisy = refine(residuals, start, problem, noise, progress, store)
        start, steps = noisy.search.theta, steps + noisy.steps
        if was_interrupted(noisy.search):
            return noisy
        if not noisy.deviance < held.deviance:
            return held._replace(steps=steps)
    read = problem._replace(lanes=as_read(problem.lanes, BetweenRows.SMOOTH))
    smooth = refine(residuals, start, read, noise, progress, store)
    return smooth._replace(steps=steps + smooth.steps)


def _acts_early(fit: RefinedFit, problem: IdentificationProblem) -> bool:
    """Whether the delay lies between -1 and 0 by its interval.

    At 0 a held command acts when it is given, at -1 when it was given to a log that has it a row late.
    """
    for k, free in enumerate(fit.residuals.free):
        if free.path == "delay":
            low, high = np.asarray(problem.bounds)[:, k]
            share = expit(fit.search.theta[k] + problem.origin[k])
            error = (high - low) * share * (1.0 - share) * np.sqrt(fit.covariance.matrix[k, k])
            delay, half = low + (high - low) * share, fit.covariance.quantile * error
            return bool(delay - half > -1.0 and delay + half < 0.0)
    return False


def on_smooth_command(
    theta: Float[np.ndarray, "*s k"], fit: RefinedFit, problem: IdentificationProblem
) -> Float[np.ndarray, "*s k"]:
    """Points in the search space of the `fit` with the delay at which a smooth command acts as a held one did."""
    moved = np.array(theta)
    for k, free in enumerate(fit.residuals.free):
        if free.path == "delay":
            low, high = np.asarray(problem.bounds)[:, k]
            share = expit(moved[..., k] + problem.origin[k]) + HALF_A_ROW / (high - low)
            moved[..., k] = logit(np.minimum(share, LATEST)) - problem.origin[k]
    return moved


def with_unknown_command(fit: RefinedFit, logged: Lanes) -> RefinedFit:
    """The fit of snapshots with an interval that also holds what the command between them may have been.

    It is known no better than the two ways to read it differ, with its noise taken out and as it was `logged`: how far
    apart their estimates are, to first order, counts as one standard deviation more.
    """
    theta, logged_too = jnp.asarray(fit.search.theta), fit.problem._replace(lanes=logged)
    read, raw = (
        np.asarray(evaluated(fit.residuals, theta, as_arrays(problem))[0]) for problem in (fit.problem, logged_too)
    )
    if not np.isfinite(raw).all():
        return fit  # under its noise the table runs off: that says nothing of how far the estimates are apart
    errors = np.sqrt(np.diag(fit.covariance.matrix))
    apart = errors * np.linalg.lstsq(fit.slope * errors, read - raw)[0]
    return fit._replace(covariance=fit.covariance._replace(matrix=fit.covariance.matrix + np.outer(apart, apart)))
