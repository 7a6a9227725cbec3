"""One reading of one log: the law's parameters, their covariance, and what they leave of the command."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tuning.identification.controller.law import Law, Reading, coefficients
from tuning.identification.controller.moments import Moments, moments
from tuning.identification.controller.search import LOG_GAIN, Problem, Solution, solve, weights
from tuning.identification.controller.signals import Condition, Equation

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
        """The factor by which the moments scatter more than their noise explains, in variance; at least one."""
        spare = len(self.solution.problem.regressors) - len(self.solution.point)
        return max(1.0, self.cost / max(spare, 1))


def search_law(equations: Sequence[Equation], period: float, reading: Reading) -> Candidate | None:
    """Search the law of the pieces of a log; None where no positive gain agrees with them."""
    sums = moments(equations)
    solution = solve(Problem(*sums.whitened(), period, reading))
    if solution is None:
        return None
    law = Law(*solution.point)
    theta, mix = coefficients(law, period, reading), weights(law, reading)
    left = _left(equations, mix, theta)
    slow = [equation.conditions[0] for equation in equations]
    share = _left(slow, mix, theta) / _rms(np.concatenate([one.commands @ mix for one in slow]))
    return Candidate(sums, solution, left, share)


def _left(several: Sequence[Equation] | Sequence[Condition], mix: np.ndarray, theta: np.ndarray) -> float:
    return _rms(np.concatenate([one.commands @ mix - one.regressors @ theta for one in several]))


def with_covariance(candidate: Candidate, samples: int | None = None) -> LawFit:
    """The fit, with the covariance of leaving out one block of rows after the other.

    That is the jackknife of Tukey, conservative where few events carry the information. To it come what was expected,
    a misfit of the moments beyond their noise (the factor of Birge), and another minimum that is about as good.
    `samples` are those over which the velocity is differenced, where each row is one.
    """
    sums, (problem, point, cost, rival) = candidate.sums, candidate.solution
    deleted = []
    for block in range(sums.blocks):
        regressors, commands = sums.whitened(block)
        rest = replace(problem, regressors=regressors, commands=commands)
        deleted.append(rest.minimise(point, steps=DELETED_STEPS)[0])
    around = np.stack(deleted) - np.mean(deleted, axis=0)
    jacobian = problem.jacobian(point)
    inverse = np.linalg.inv(jacobian.T @ jacobian)
    from_expected = inverse @ np.diag(problem.spread**-2) @ inverse
    birge = candidate.birge
    covariance = birge * (sums.blocks - 1) / sums.blocks * around.T @ around + from_expected
    if rival is not None:
        share = 1.0 / (1.0 + np.exp(min(0.5 * (rival[1] - cost) / birge, 500.0)))
        covariance = covariance + share * (1.0 - share) * np.outer(rival[0] - point, rival[0] - point)
    rows = samples if samples is not None else float(Law(*point).window.real)
    return LawFit(
        point,
        covariance,
        sums.blocks - 1,
        candidate.unexplained,
        problem.period,
        problem.reading,
        window=rows * problem.period,
    )


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))
