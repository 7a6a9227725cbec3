"""One reading of one log: the law's parameters, their covariance, and what they leave of the command."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from tuning.identification.controller.law import Law, Reading, coefficients
from tuning.identification.controller.moments import Moments, moments
from tuning.identification.controller.search import Problem, Solution, solve, weights
from tuning.identification.controller.signals import Equation

DELETED_STEPS = 6  # from the solution with all blocks, which is near


@dataclass(frozen=True)
class LawFit:
    """The parameters [p] of `Law` and their covariance [p, p], with its degrees of freedom.

    `residual` is the root mean square of what is left of the command (N), `command` that of the command.
    """

    parameters: Float[np.ndarray, " p"]
    covariance: Float[np.ndarray, "p p"]
    freedom: int
    residual: float
    command: float
    period: float
    reading: Reading

    @property
    def law(self) -> Law:
        """The parameters by name."""
        return Law(*self.parameters)


@dataclass(frozen=True)
class Candidate:
    """A reading of a log, searched: what readings are chosen by. Its covariance costs a search for each block."""

    sums: Moments
    solution: Solution
    residual: float
    command: float

    @property
    def cost(self) -> float:
        """Sum of squares of the moments, in units of their noise."""
        return self.solution.cost

    @property
    def birge(self) -> float:
        """The factor by which the moments scatter more than their noise explains, in variance; at least one."""
        spare = len(self.solution.problem.regressors) - len(self.solution.point)
        return max(1.0, self.cost / max(spare, 1))


def search_law(equations: Sequence[Equation], period: float, reading: Reading) -> Candidate | None:
    """Search the law of the pieces of a log; None where no positive gain agrees with them."""
    sums = moments(equations)
    solution = solve(Problem(*sums.whitened(), free_noise(equations), period, reading))
    if solution is None:
        return None
    law = Law(*solution.point)
    theta, mix = coefficients(law, period, reading), weights(law, reading)
    left = np.concatenate([u @ mix - x @ theta for x, _, u in equations])
    return Candidate(sums, solution, _rms(left), _rms(_commands(equations)))


def with_covariance(candidate: Candidate) -> LawFit:
    """The fit, with the covariance of leaving out one block of rows after the other.

    That is the jackknife of Tukey, conservative where few events carry the information. To it come what was expected,
    a misfit of the moments beyond their noise (the factor of Birge), and another minimum that is about as good.
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
    return LawFit(
        point, covariance, sums.blocks - 1, candidate.residual, candidate.command, problem.period, problem.reading
    )


def free_noise(equations: Sequence[Equation]) -> float:
    """What is left of the command with coefficients that no law binds (N): least squares."""
    columns = np.concatenate([x for x, _, _ in equations])
    command = _commands(equations)
    scale = np.linalg.norm(columns, axis=0)
    unit, _ = np.linalg.qr(columns / np.where(scale > 0, scale, 1.0))
    left = command - unit @ (unit.T @ command)
    return max(_rms(left), float(np.finfo(float).eps) * _rms(command))


def _commands(equations: Sequence[Equation]) -> np.ndarray:
    return np.concatenate([u[:, u.shape[1] // 2] for _, _, u in equations])


def _rms(signal: np.ndarray) -> float:
    return float(np.sqrt(np.mean(signal**2)))
