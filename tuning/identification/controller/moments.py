"""What a log says of the law's coefficients, in sums over blocks of rows: all that search and intervals need."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from tuning.identification.controller.signals import Condition, Equation, Rows

BLOCKS = 24  # of a log; t with 23 degrees of freedom is 2.07 where the normal quantile is 1.96, and each block is
# some tenths of a second of the usual log, longer than a loop remembers (Ibragimov and Müller 2010)


@dataclass(frozen=True)
class Moments:
    """Sums over the rows of each block: of instruments with regressors and with commands, [b, q, ...].

    `variances` are those of the sums of what no coefficients explain (Hansen's weighting), had it no memory.
    """

    variances: Float[np.ndarray, "b q q"]
    regressors: Float[np.ndarray, "b q k"]
    commands: Float[np.ndarray, "b q c"]

    @property
    def blocks(self) -> int:
        """How many there are."""
        return len(self.variances)

    def whitened(self, without: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Sums with regressors and commands in standard deviations, [q, k] and [q, c], without one block."""
        keep = np.arange(self.blocks) != (-1 if without is None else without)
        zx, zu = (part[keep].sum(axis=0) for part in (self.regressors, self.commands))
        root = _whitening(self.variances[keep].sum(axis=0))
        return root @ zx, root @ zu

    def scatter(self, mix: Float[np.ndarray, " c"], theta: Float[np.ndarray, " k"]) -> float:
        """By what factor the sums of blocks scatter more than their noise would without a memory, in variance.

        A block has a share V of all information, and so V of the sum over all is expected in it. Noise leaves a mean
        square of tr(V - V^2) around that: a block that carries nearly everything says nothing. One, where none says
        anything.
        """
        root = _whitening(self.variances.sum(axis=0))
        left = (self.commands @ mix - self.regressors @ theta) @ root.T
        shares = root @ self.variances @ root.T
        around = left - shares @ left.sum(axis=0)
        expected = root.shape[0] - np.sum(shares**2)
        return float(np.sum(around**2) / expected) if expected > LEAST_INFORMATION else 1.0


def _whitening(variances: Float[np.ndarray, "q q"]) -> Float[np.ndarray, "r q"]:
    """The matrix that makes sums of these variances independent and of unit variance."""
    scale = np.sqrt(np.diag(variances))
    scale = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(variances / np.outer(scale, scale))
    kept = values > values[-1] * RANK
    return (vectors[:, kept] / np.sqrt(values[kept])).T / scale


LEAST_INFORMATION = 1.0  # a variance from less than one square is no estimate
RANK = 1e-13  # of the normal equations of unit instruments, in which a direction below it is rounding


def moments(equations: Sequence[Equation]) -> Moments:
    """The sums over the pieces of one log, in blocks of about equal length."""
    rows = sum(len(equation.commands) for equation in equations)
    length = max(1, -(-rows // BLOCKS))
    levels = [_level(same) for same in zip(*(equation.conditions for equation in equations), strict=True)]
    found: list[tuple[Rows, Rows, Rows]] = []
    for equation in equations:
        count = max(1, round(len(equation.commands) / length))
        for part in np.array_split(np.arange(len(equation.commands)), count):
            found.append(_sums(equation.conditions, part, levels))
    return Moments(*(np.stack(parts) for parts in zip(*found, strict=True)))


def _sums(conditions: Sequence[Condition], rows: np.ndarray, levels: Sequence[float]) -> tuple[Rows, Rows, Rows]:
    variances, regressors, commands = [], [], []
    for (z, x, u, excess, _), level in zip(conditions, levels, strict=True):
        variances.append(level**2 * z[rows].T @ z[rows])
        regressors.append(z[rows].T @ x[rows] + len(rows) * excess)
        commands.append(z[rows].T @ u[rows])
    return block_diag(*variances), np.concatenate(regressors), np.concatenate(commands)


def _level(same: Sequence[Condition]) -> float:
    """What is left of the command where the instruments look (N), with coefficients that no law binds."""
    looked = [np.any(one.instruments != 0, axis=1) for one in same]
    if not any(rows.any() for rows in looked):  # a position without noise
        return 1.0
    columns = np.concatenate([one.regressors[rows] for one, rows in zip(same, looked, strict=True)])
    command = np.concatenate([one.commands[rows] for one, rows in zip(same, looked, strict=True)])
    return same[0].level * float(left_free(columns, command[:, command.shape[1] // 2]))


def left_free(columns: Rows, commands: Float[np.ndarray, "n ..."]) -> Float[np.ndarray, "..."]:
    """Root mean square of what least squares leave of each command; not less than its rounding."""
    scale = np.linalg.norm(columns, axis=0)
    unit, _ = np.linalg.qr(columns / np.where(scale > 0, scale, 1.0))
    left = commands - unit @ (unit.T @ commands)
    rounding = float(np.finfo(float).eps)
    return np.maximum(np.sqrt(np.mean(left**2, axis=0)), rounding * np.sqrt(np.mean(commands**2, axis=0)))
