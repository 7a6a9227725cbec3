"""One reading of one log: the law's parameters, their covariance, and what they leave of the command."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from tuning.identification.controller.law import Law, Reading, coefficients
from tuning.identification.controller.moments import Moments, moments
from tuning.identification.controller.search import LATE, LOG_GAIN, MASS, Problem, Solution, solve, starts_of, weights
from tuning.identification.controller.signals import Condition, Equation

# What may not be there, a fed-forward acceleration and another instant of the fed-forward speed. In the force they look
# alike, and but for the integral's part they cannot both be told
HELD = ((MASS, LATE), (LATE,), (MASS,), ())
DELETED_STEPS = 6  # from the solution with all blocks, which is near


class Alternative(NamedTuple):
    """What the law may be: how likely it is, its parameters [p] and their covariance [p, p]."""

    share: float
    parameters: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]


@dataclass(frozen=True)
class LawFit:
    """What the law may be, the likeliest first, and the degrees of freedom of its covariance.

    `unexplained` is the share of the command that is left, where the rows are snapshots of its slow part; `window` is
    the time over which the velocity is differenced (s).
    """

    mixture: tuple[Alternative, ...]
    freedom: int
    unexplained: float
    period: float
    reading: Reading
    window: float

    @property
    def law(self) -> Law:
        """The likeliest parameters by name."""
        return Law(*self.mixture[0].parameters)


@dataclass(frozen=True)
class Candidate:
    """A reading of a log, searched. Its covariance costs a search for each block.

    `residual` is the root mean square of what is left of the command (N), by which readings are chosen.
    """

    sums: Moments
    solution: Solution
    others: tuple[Solution, ...]  # what else may be, each a minimum
    birge: float  # the factor by which the moments scatter more than their noise explains, in variance
    excess_misfit: float  # that by which the solution misfits them beyond what their blocks scatter, in variance
    residual: float
    unexplained: float

    @property
    def cost(self) -> float:
        """Sum of squares of the moments, in units of their noise."""
        return self.solution.cost

    @property
    def gain(self) -> float:
        """The velocity gain with half a period of the integral, K (N s/m)."""
        return float(np.exp(self.solution.point[LOG_GAIN]))


def search_law(
    equations: Sequence[Equation], period: float, reading: Reading, held: Sequence[tuple[int, ...]] = HELD
) -> Candidate | None:
    """Search the law of the pieces of a log, each time with other parameters held; None where no positive gain agrees
    with them.
    """
    sums = moments(equations)
    problem = Problem(*sums.whitened(), period, reading)
    starts = starts_of(problem)
    minima = [one for each in held for one in solve(replace(problem, held=each), starts)]
    if not minima:
        return None
    best = min(minima, key=_of_moments)
    memory = max(1.0, _scatter(sums, best))
    birge = max(memory, _misfit(best))
    solution, *others = sorted(minima, key=lambda one: unlikelihood(one, birge))
    law = Law(*solution.point)
    theta, mix = coefficients(law, period, reading), weights(law, reading)
    left = _left(equations, mix, theta)
    slow = [equation.conditions[0] for equation in equations]
    share = _left(slow, mix, theta) / _rms(np.concatenate([one.commands @ mix for one in slow]))
    return Candidate(sums, solution, tuple(others), birge, max(1.0, _misfit(solution) / memory), left, share)


def _of_moments(solution: Solution) -> float:
    """Their sum of squares, without what was expected."""
    return float(np.sum(solution.problem.residuals(solution.point)[: -len(solution.point)] ** 2))


def _misfit(solution: Solution) -> float:
    """The factor by which the moments misfit a law more than their noise explains, in variance.

    One, where there are no more moments than parameters: they cannot misfit.
    """
    spare = len(solution.problem.regressors) - (len(solution.point) - len(solution.problem.held))
    return _of_moments(solution) / spare if spare > 0 else 1.0


def _scatter(sums: Moments, solution: Solution) -> float:
    """That by which their blocks scatter: what a law leaves of the command has a memory."""
    problem, law = solution.problem, Law(*solution.point)
    return sums.scatter(weights(law, problem.reading), coefficients(law, problem.period, problem.reading))


def unlikelihood(solution: Solution, birge: float) -> float:
    """-2 log evidence of a minimum (Laplace), the noise of the moments being as large as they scatter."""
    problem, left = solution.problem, _of_moments(solution)
    volume = problem.curvature(solution.point, birge).log_determinant + 2.0 * float(np.sum(np.log(problem.spread)))
    return left / birge + solution.cost - left + volume


def _left(several: Sequence[Equation] | Sequence[Condition], mix: np.ndarray, theta: np.ndarray) -> float:
    return _rms(np.concatenate([one.commands @ mix - one.regressors @ theta for one in several]))


def with_covariance(candidate: Candidate, samples: int | None = None) -> LawFit:
    """The fit, with the covariance of leaving out one block of rows after the other.

    That is the jackknife of Tukey, conservative where few events carry the information. It has what blocks scatter; to
    it come what was expected and a misfit beyond that (the factor of Birge). What else may be stands beside it, as
    likely as it is. `samples` are those over which the velocity is differenced, where each row is one.
    """
    sums, (problem, point, _) = candidate.sums, candidate.solution
    deleted = []
    for block in range(sums.blocks):
        regressors, commands = sums.whitened(block)
        rest = replace(problem, regressors=regressors, commands=commands)
        deleted.append(rest.minimise(point, steps=DELETED_STEPS)[0])
    around = np.stack(deleted) - np.mean(deleted, axis=0)
    inverse = problem.curvature(point).inverse
    from_expected = inverse @ np.diag(problem.spread**-2) @ inverse
    covariance = candidate.excess_misfit * (sums.blocks - 1) / sums.blocks * around.T @ around + from_expected
    rows = samples if samples is not None else float(Law(*point).window.real)
    return LawFit(
        _mixture(candidate, covariance),
        sums.blocks - 1,
        candidate.unexplained,
        problem.period,
        problem.reading,
        window=rows * problem.period,
    )


def _mixture(candidate: Candidate, covariance: Float[np.ndarray, "p p"]) -> tuple[Alternative, ...]:
    """All minima, each as likely as its evidence has it, the likeliest first."""
    minima, birge = [candidate.solution, *candidate.others], candidate.birge
    unlikely = np.array([unlikelihood(one, birge) for one in minima])
    share = np.exp(-0.5 * (unlikely - unlikely[0]))
    own = [covariance, *(one.problem.curvature(one.point, birge).inverse for one in candidate.others)]
    return tuple(
        Alternative(float(weight), one.point, spread)
        for weight, one, spread in zip(share / np.sum(share), minima, own, strict=True)
    )


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))
