"""Whether the rows of a log are every sample of the control, or snapshots of a faster loop, as the fits show it."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from diffdrive.numerics.arrays import as_arrays
from tuning.identification.adequacy import DEVIANCE
from tuning.identification.command_noise import without_noise
from tuning.identification.prediction import Lanes
from tuning.identification.problem import IdentificationProblem
from tuning.identification.refinement import RefinedFit, evaluated, most_likely_at, refine, was_interrupted
from tuning.identification.row_force import BetweenRows
from tuning.optimisation.least_squares import StepProgress
from tuning.store.store import Store

HELD, SMOOTH = BetweenRows


def lacks_force(fit: RefinedFit) -> bool:
    """Whether the fit became likelier beyond any chance as its filter invented a force."""
    return not was_interrupted(fit.search) and fit.deviance_gain > DEVIANCE


def as_read(lanes: Lanes, between: BetweenRows) -> Lanes:
    """The lanes with their command as it acts: that of snapshots without the noise of its loop."""
    if between is HELD:
        return lanes
    command = without_noise(np.asarray(lanes.command), np.asarray(lanes.counts))
    return lanes._replace(command=jnp.asarray(command))


def as_rows_show(
    held: RefinedFit,
    problem: IdentificationProblem,
    noise: float,
    progress: StepProgress,
    store: Store | None,
    between: BetweenRows | None = None,
) -> RefinedFit:
    """The fit of a command that is held between rows, or of a smooth one where that explains the rows better.

    Both have the same parameters, so that their likelihoods can be compared. Where a held command would act before it
    was given, the smooth one is fitted: with the command as it was logged, and with its noise taken out, which weighs
    against it. Elsewhere it has to be likelier at the point that the held one was fitted to. Where the held command
    leaves no force missing, nothing else is tried. A held fit that got stuck makes any other reading likelier: where
    the smooth command turns out to act no earlier than a held one may, the held one is fitted again from there.

    `problem` is the one that the fit began with; `between` is what the command is known to do.
    """
    if was_interrupted(held.search) or (between is None and not lacks_force(held)):
        return held
    without = problem._replace(lanes=as_read(problem.lanes, SMOOTH))
    steps, fits = held.steps, dict[tuple[BetweenRows, bool], RefinedFit]()

    def deviance(between: BetweenRows, is_noisy: bool) -> float:
        nonlocal steps
        residuals = dataclasses.replace(held.residuals, between=between)
        fit = refine(residuals, held.search.theta, problem if is_noisy else without, noise, progress, store)
        steps += fit.steps
        if was_interrupted(fit.search):
            raise KeyboardInterrupt
        fits[between, is_noisy] = fit
        return fit.deviance

    try:
        if between is None and _acts_early(held):
            is_smooth = deviance(SMOOTH, is_noisy=True) < held.deviance
            without_it = deviance(SMOOTH, is_noisy=False)
            is_smooth = is_smooth or without_it < deviance(HELD, is_noisy=False)
        else:
            there = dataclasses.replace(held.residuals, between=SMOOTH), held.search.theta, problem, noise
            is_smooth = between is SMOOTH or most_likely_at(*there).deviance < held.deviance
            if is_smooth:
                deviance(SMOOTH, is_noisy=False)
        if not is_smooth:
            return held._replace(steps=steps)
        smooth = fits[SMOOTH, False]
        if between is SMOOTH or _acts_early(smooth):
            return smooth._replace(steps=steps)
        again = refine(held.residuals, smooth.search.theta, problem, noise, progress, store)
        best = again if was_interrupted(again.search) or again.deviance < smooth.deviance else smooth
        return best._replace(steps=steps + again.steps)
    except KeyboardInterrupt:
        return held._replace(search=held.search.interrupted(), steps=steps)


def _acts_early(fit: RefinedFit) -> bool:
    """Whether the delay lies between -1 and 0 by its interval.

    At 0 a held command acts when it is given, at -1 when it was given to a log that has it a row late.
    """
    paths = [free.path for free in fit.residuals.free]
    if "delay" not in paths:
        return False
    k = paths.index("delay")
    half = np.zeros(len(paths))
    half[k] = fit.covariance.quantile * np.sqrt(fit.covariance.matrix[k, k])
    low, high = (
        float(fit.residuals.unpack(jnp.asarray(theta), fit.problem)[1].delay)
        for theta in (fit.search.theta - half, fit.search.theta + half)
    )
    return low > -1.0 and high < 0.0


def with_unknown_command(fit: RefinedFit, logged: Lanes) -> RefinedFit | None:
    """The fit of snapshots with an interval that also holds what the command between them may have been.

    It is known no better than the two ways to read it differ, with its noise taken out and as it was `logged`: how far
    apart their estimates are, to first order, counts as one standard deviation more. None where the table runs off
    under the command as it was logged.
    """
    theta, logged_too = jnp.asarray(fit.search.theta), fit.problem._replace(lanes=logged)
    read, raw = (
        np.asarray(evaluated(fit.residuals, theta, as_arrays(problem))[0]) for problem in (fit.problem, logged_too)
    )
    if not np.isfinite(raw).all():
        return None
    errors = np.sqrt(np.diag(fit.covariance.matrix))
    apart = errors * np.linalg.lstsq(fit.slope * errors, read - raw)[0]
    return fit._replace(covariance=fit.covariance._replace(matrix=fit.covariance.matrix + np.outer(apart, apart)))
