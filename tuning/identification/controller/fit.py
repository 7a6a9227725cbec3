"""One reading of one log: the law's parameters, their covariance, and what they leave of the command."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tuning.identification.controller.law import Law, Reading, coefficients
from tuning.identification.controller.moments import Moments, moments
from tuning.identification.controller.search import LATE, LOG_GAIN, MASS, Problem, Solution, solve, weights
from tuning.identification.controller.signals import Condition, Equation

# What may not be there, a fed-forward acceleration and another instant of the fed-forward speed. In the force they look
# alike, and but for the integral's part they cannot both be told
HELD = ((MASS, LATE), (LATE,), (MASS,), ())
DELETED_STEPS = 6  # from the solution with all blocks, which is near


@dataclass(frozen=True)
class LawFit:
    """The parameters [p] of `Law` and their covariance [p, p], with its degrees of freedom.

    `unexplained` is the share of the command that is left, where the rows are snapshots of its slow part; `window` is
    the time over which the velocity is differenced (s).
    """

    parameters: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    freedom: int
    unexplained: float
    period: float
    reading: Reading
    window: float

    @property
    def law(self) -> Law:
        """The parameters by name."""
        return Law(*self.parameters)


@dataclass(frozen=True)
class Candidate:
    """A reading of a log, searched. Its covariance costs a search for each block.

    `residual` is the root mean square of what is left of the command (N), by which readings are chosen.
    """

    sums: Moments
    solution: Solution
    others: tuple[Solution, ...]  # what else may be, each a minimum
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

    @property
    def birge(self) -> float:
        """That of the solution."""
        return _birge(self.solution)


def search_law(
    equations: Sequence[Equation], period: float, reading: Reading, held: Sequence[tuple[int, ...]] = HELD
) -> Candidate | None:
    """Search the law of the pieces of a log, each time with other parameters held; None where no positive gain agrees
    with them.
    """
    sums = moments(equations)
    problem = Problem(*sums.whitened(), period, reading)
    minima = [one for each in held for one in solve(replace(problem, held=each))]
    if not minima:
        return None
    birge = _birge(min(minima, key=lambda one: one.cost))
    solution, *others = sorted(minima, key=lambda one: unlikelihood(one, birge))
    law = Law(*solution.point)
    theta, mix = coefficients(law, period, reading), weights(law, reading)
    left = _left(equations, mix, theta)
    slow = [equation.conditions[0] for equation in equations]
    share = _left(slow, mix, theta) / _rms(np.concatenate([one.commands @ mix for one in slow]))
    return Candidate(sums, solution, tuple(others), left, share)


def _birge(solution: Solution) -> float:
    """The factor by which the moments scatter more than their noise explains, in variance; at least one."""
    spare = len(solution.problem.regressors) - len(solution.point)
    return max(1.0, solution.cost / max(spare, 1))


def unlikelihood(solution: Solution, birge: float) -> float:
    """-2 log evidence of a minimum (Laplace), the noise of the moments being as large as they scatter."""
    problem, free = solution.problem, len(solution.point)
    jacobian, residuals = problem.jacobian(solution.point), problem.residuals(solution.point)
    volume = np.linalg.slogdet(jacobian.T @ jacobian)[1] + 2.0 * np.sum(np.log(problem.spread))
    return float(np.sum(residuals[:-free] ** 2) / birge + np.sum(residuals[-free:] ** 2) + volume)


def _left(several: Sequence[Equation] | Sequence[Condition], mix: np.ndarray, theta: np.ndarray) -> float:
    return _rms(np.concatenate([one.commands @ mix - one.regressors @ theta for one in several]))


def with_covariance(candidate: Candidate, samples: int | None = None) -> LawFit:
    """The fit, with the covariance of leaving out one block of rows after the other.

    That is the jackknife of Tukey, conservative where few events carry the information. To it come what was expected,
    a misfit of the moments beyond their noise (the factor of Birge), and what else may be, as likely as it is: the
    parameters are the mean of all that. `samples` are those over which the velocity is differenced, where each row is
    one.
    """
    sums, (problem, point, _) = candidate.sums, candidate.solution
    deleted = []
    for block in range(sums.blocks):
        regressors, commands = sums.whitened(block)
        rest = replace(problem, regressors=regressors, commands=commands)
        deleted.append(rest.minimise(point, steps=DELETED_STEPS)[0])
    around = np.stack(deleted) - np.mean(deleted, axis=0)
    from_expected = problem.inverse(point) @ np.diag(problem.spread**-2) @ problem.inverse(point)
    birge = candidate.birge
    covariance = birge * (sums.blocks - 1) / sums.blocks * around.T @ around + from_expected
    mean, covariance = _with_others(candidate, covariance)
    rows = samples if samples is not None else float(Law(*point).window.real)
    return LawFit(
        mean,
        covariance,
        sums.blocks - 1,
        candidate.unexplained,
        problem.period,
        problem.reading,
        window=rows * problem.period,
    )


def _with_others(candidate: Candidate, covariance: Float[np.ndarray, "p p"]) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the parameters over all minima, each as likely as its evidence has it."""
    minima, birge = [candidate.solution, *candidate.others], candidate.birge
    unlikely = np.array([unlikelihood(one, birge) for one in minima])
    share = np.exp(-0.5 * (unlikely - unlikely[0]))
    share /= np.sum(share)
    points = np.stack([one.point for one in minima])
    own = np.stack([covariance, *(birge * one.problem.inverse(one.point) for one in candidate.others)])
    mean = share @ points
    apart = points - mean
    return mean, np.einsum("m,mij->ij", share, own) + np.einsum("m,mi,mj->ij", share, apart, apart)


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))
