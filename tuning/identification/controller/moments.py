"""What a log says of the law's coefficients, in sums over blocks of rows: all that search and intervals need."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from tuning.identification.controller.signals import Equation

BLOCKS = 24  # of a log; t with 23 degrees of freedom is 2.07 where the normal quantile is 1.96, and each block is
# some tenths of a second of the usual log, longer than a loop remembers (Ibragimov and Müller 2010)


@dataclass(frozen=True)
class Moments:
    """Sums over the rows of each block: instruments with instruments, regressors and commands, [b, q, ...].

    `scale` are the root mean squares of the instruments, by which all is divided: units differ by powers of ten.
    """

    instruments: Float[np.ndarray, "b q q"]
    regressors: Float[np.ndarray, "b q k"]
    commands: Float[np.ndarray, "b q c"]

    @property
    def blocks(self) -> int:
        """How many there are."""
        return len(self.instruments)

    def whitened(self, without: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Regressors and commands projected on orthonormal instruments, [q, k] and [q, c], without one block."""
        keep = np.arange(self.blocks) != (-1 if without is None else without)
        zz, zx, zu = (part[keep].sum(axis=0) for part in (self.instruments, self.regressors, self.commands))
        scale = np.sqrt(np.diag(zz))
        scale = np.where(scale > 0, scale, 1.0)
        values, vectors = np.linalg.eigh(zz / np.outer(scale, scale))
        kept = values > values[-1] * RANK
        root = (vectors[:, kept] / np.sqrt(values[kept])).T / scale
        return root @ zx, root @ zu


RANK = 1e-13  # of the normal equations of unit instruments, in which a direction below it is rounding


def moments(equations: Sequence[Equation]) -> Moments:
    """The sums over the pieces of one log, in blocks of about equal length."""
    rows = sum(len(equation.commands) for equation in equations)
    length = max(1, -(-rows // BLOCKS))
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    for x, z, u in equations:
        count = max(1, round(len(u) / length))
        for part in np.array_split(np.arange(len(u)), count):
            found.append((z[part].T @ z[part], z[part].T @ x[part], z[part].T @ u[part]))
    zz, zx, zu = (np.stack(parts) for parts in zip(*found, strict=True))
    return Moments(zz, zx, zu)


def joined(several: Sequence[Moments]) -> Moments:
    """The moments of several logs of one controller."""
    parts = [(one.instruments, one.regressors, one.commands) for one in several]
    return Moments(*(np.concatenate(same) for same in zip(*parts, strict=True)))
