"""Whether another start explains the logs as well, elsewhere: then they do not decide between two answers."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Float

from diffdrive.numerics.arrays import as_arrays
from tuning.identification.estimates import reported_parameters, symmetric_bristle
from tuning.identification.refinement import (
    OFFSET,
    ROUGH_GAIN,
    TOLERANCE,
    RefinedFit,
    evaluated,
    normalised_innovations,
)
from tuning.identification.uncertainty import BLOCK
from tuning.optimisation.least_squares import Outcome, StepProgress, levenberg_marquardt

APART = 0.25  # in units of belief, as that of what is not determined: half as much again
WITHIN = 2.0  # times the best cost, beyond which a start that had as many steps is stuck and no rival
STEPS = 16  # of the search from another start, twice those that it had: one that is not as good by then is no rival
CHANCE = 0.01  # that an answer that is as good seems worse


class RivalValue(NamedTuple):
    """A parameter as it was found, and as another start has it that explains the logs as well."""

    name: str
    unit: str
    value: float
    other: float

    @property
    def words(self) -> str:
        """Both values."""
        unit = "" if self.unit == "1" else f" {self.unit.replace('*', ' ')}"
        return f"{self.name} {self.value:.3g} or {self.other:.3g}{unit}"


def rival_start(
    points: Float[np.ndarray, "s k"], costs: Float[np.ndarray, " s"], prior: Float[np.ndarray, " k"]
) -> Float[np.ndarray, " k"] | None:
    """Of coarse searches the best that ended elsewhere than the best of all; None where all that ended agree."""
    best = points[int(np.argmin(costs))]
    elsewhere = np.any(np.abs(prior * (points - best)) > APART, axis=1) & (costs <= WITHIN * np.min(costs))
    if not elsewhere.any():
        return None
    return points[int(np.argmin(np.where(elsewhere, costs, np.inf)))]


def is_as_good(
    rival: Float[np.ndarray, "lanes n"], found: Float[np.ndarray, "lanes n"], rate: float, chance: float = CHANCE
) -> bool:
    """Whether the innovations of a rival are not larger, in blocks of a quarter of a second, than chance makes them.

    A one-sided t test of the blocks' mean squares: they scatter as the residuals do, whatever their colour. Were the
    rival as good, its blocks would scatter as those found do, and the difference by no more than both together: a rival
    that runs off in some blocks is not excused by how much they scatter.
    """
    block = max(1, round(BLOCK * rate))
    squares = np.stack([rival**2, found**2])[..., : rival.shape[1] // block * block].reshape(2, -1, block)
    blocks = squares[:, np.any(squares != 0.0, axis=(0, 2))].mean(axis=2)
    rise, count = blocks[0] - blocks[1], blocks.shape[1]
    if count < 2 or not np.mean(rise) > 0.0:
        return True
    scatter = min(np.std(rise, ddof=1), np.sqrt(2.0) * np.std(blocks[1], ddof=1))
    return bool(scipy.stats.t.sf(np.mean(rise) * np.sqrt(count), count - 1, scale=max(scatter, 1e-300)) >= chance)


def rival_values(
    fit: RefinedFit,
    points: Float[np.ndarray, "s k"],
    costs: Float[np.ndarray, " s"],
    undetermined: set[str],
    progress: StepProgress,
) -> tuple[RivalValue, ...]:
    """What another start has elsewhere, though it explains the logs as well; empty where the starts agree.

    Of all starts the best that ended elsewhere goes on under the gains that the fit went by.
    """
    start = rival_start(points, costs, fit.problem.prior)
    if start is None:
        return ()
    residuals, arrays = fit.residuals, as_arrays(fit.problem)
    search = levenberg_marquardt(
        residuals, start, arrays, max_steps=STEPS, tolerance=TOLERANCE, min_gain=ROUGH_GAIN, min_offset=OFFSET,
        progress=progress,
    )  # fmt: skip
    moved = np.abs(search.theta - fit.search.theta)
    # two answers within their intervals are one
    allowed = np.sqrt(2.0) * fit.covariance.quantile * np.sqrt(np.diag(fit.covariance.matrix))
    far = (fit.problem.prior * moved > APART) & (moved > allowed)
    apart = {free.path for free, is_far in zip(residuals.free, far, strict=True) if is_far} - undetermined
    if search.outcome is Outcome.INTERRUPTED or not apart:
        return ()
    other = fit.with_prediction(evaluated(residuals, jnp.asarray(search.theta), arrays)[1])
    found_innovation, other_innovation = normalised_innovations(fit), normalised_innovations(other)
    rate = residuals.sampling.rate * fit.problem.lanes.encoders
    if not np.isfinite(other_innovation).all() or not is_as_good(other_innovation, found_innovation, rate):
        return ()
    symmetric = symmetric_bristle(fit.problem)
    here, there = (
        reported_parameters(*residuals.unpack(jnp.asarray(theta), fit.problem), symmetric)
        for theta in (fit.search.theta, search.theta)
    )
    found: dict[str, RivalValue] = {}
    for mine, others in zip(here, there, strict=True):
        if mine.unknown in apart and mine.unknown not in found:  # of several that rest on one, the first
            name = mine.path.partition(".")[2]
            found[mine.unknown] = RivalValue(name, mine.parameter.unit, float(mine.value), float(others.value))
    return tuple(found.values())
