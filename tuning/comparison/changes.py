"""Which parameters differ between two fits: the smallest set of changes that explains how their estimates differ.

d = after - before has the covariance S = S_before + S_after. To free the changes of some parameters is to judge the
others alone: what is left is the distance d_c' S_cc^-1 d_c of those that are held (generalised least squares, its
minimum over the freed changes). Two tests, both of Hotelling's kind, since S is estimated from a number of blocks:

- that nothing else has changed: the distance of all that is held, T^2 (Hotelling 1931);
- that none of them has: the distance that a parameter takes away when it is freed, given the others (Rao's test of
  additional information), the least of whose p-values is multiplied by the number of parameters (Bonferroni).

The first sees many small changes, the second a single one. They share the level: twice the smaller p-value is that of
"nothing changed". Of the sets whose rest is not refuted the smallest is the answer. So where nothing has changed a
change is named in a share `level` of the comparisons, or fewer; and a larger set than the true one is named as rarely,
for the true set is refuted as rarely.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy.special
import scipy.stats
from jaxtyping import Float

CONFIDENCE = 0.95  # of the intervals
POWER = 0.9  # share of the changes of the size that is called the smallest which would have been found


class Estimates(NamedTuple):
    """Estimates of one side, [k], their covariance, and the degrees of freedom of that."""

    values: Float[np.ndarray, " k"]
    covariance: Float[np.ndarray, "k k"]
    freedom: float


class Interval(NamedTuple):
    """A change between the ends of its 95 % interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Difference:
    """Two sides of the same components, each component part of the parameter that `parameters` names."""

    parameters: tuple[str, ...]
    before: Estimates
    after: Estimates

    @cached_property
    def names(self) -> tuple[str, ...]:
        """The parameters, each once."""
        return tuple(dict.fromkeys(self.parameters))

    @property
    def change(self) -> Float[np.ndarray, " k"]:
        """After minus before."""
        return self.after.values - self.before.values

    def rows(self, names: Sequence[str]) -> list[int]:
        """The components of these parameters."""
        return [k for k, name in enumerate(self.parameters) if name in names]

    def held(self, freed: Sequence[str]) -> tuple[str, ...]:
        """The parameters but those that are freed."""
        return tuple(name for name in self.names if name not in freed)

    def distance(self, names: Sequence[str]) -> tuple[float, float]:
        """T^2 of these parameters from no change, and the degrees of freedom of its covariance (Yao 1965)."""
        key = frozenset(names)
        if key not in self._distances:
            self._distances[key] = self._distance(self.rows(names))
        return self._distances[key]

    @cached_property
    def _distances(self) -> dict[frozenset[str], tuple[float, float]]:
        return {}

    def _distance(self, rows: list[int]) -> tuple[float, float]:
        if not rows:
            return 0.0, self.before.freedom + self.after.freedom
        change, block = self.change[rows], np.ix_(rows, rows)
        sides = [(side.covariance[block], side.freedom) for side in (self.before, self.after)]
        weighed = _solve(sides[0][0] + sides[1][0], change)
        total = float(change @ weighed)
        shares = [float(weighed @ covariance @ weighed) / total if total > 0.0 else 0.5 for covariance, _ in sides]
        spread = sum(share**2 / freedom for share, (_, freedom) in zip(shares, sides, strict=True))
        return total, 1.0 / spread

    def p_joint(self, names: Sequence[str]) -> float:
        """How often parameters that have not changed would be as far from no change as these."""
        size = len(self.rows(names))
        if not size:
            return 1.0
        total, freedom = self.distance(names)
        left = max(1.0, freedom - size + 1.0)
        return float(scipy.special.fdtrc(size, left, total * left / (freedom * size)))

    def p_alone(self, name: str, held: Sequence[str]) -> float:
        """The same of one parameter of those `held`, given that the others have not changed."""
        size, own = len(self.rows(held)), len(self.rows([name]))
        total, freedom = self.distance(held)
        rest, _ = self.distance([other for other in held if other != name])
        left = max(1.0, freedom - size + 1.0)
        return float(scipy.special.fdtrc(own, left, left / own * max(0.0, total - rest) / (freedom + rest)))

    def p_unchanged(self, held: Sequence[str]) -> float:
        """How often the parameters `held` would seem to have changed as much as they do, if none of them had."""
        if not held:
            return 1.0
        alone = min(self.p_alone(name, held) for name in held)
        return min(1.0, 2.0 * min(self.p_joint(held), len(held) * alone))

    def explanations(self, level: float) -> list[tuple[str, ...]]:
        """The smallest sets of changed parameters whose rest is not refuted at the `level`, the likeliest first.

        Of several of one size those are left out that are 1 / `level` times less likely than the first.
        """
        for size in range(len(self.names) + 1):
            sets = list(itertools.combinations(self.names, size))
            kept = [one for one in sets if self.p_unchanged(self.held(one)) > level]
            if kept:
                left = {one: self.distance(self.held(one))[0] for one in kept}
                # the likelihood of a set is exp(-T^2 / 2) of what it leaves
                near = min(left.values()) - 2.0 * np.log(level)
                return sorted((one for one in kept if left[one] <= near), key=left.__getitem__)
        raise AssertionError("a set of all parameters leaves nothing to refute")

    def intervals(self, freed: Sequence[str]) -> list[Interval]:
        """The changes of the components that are freed, the others unchanged: with 95 % confidence.

        The regression of the freed components on the held ones, whose weights are estimated, too (Anderson 2003, 5.2).
        """
        rows, rest = self.rows(freed), self.rows(self.held(freed))
        values, covariance, freedom = self._given(rows, rest)
        widths = float(scipy.stats.t.ppf(0.5 + 0.5 * CONFIDENCE, freedom)) * np.sqrt(np.diag(covariance))
        return [Interval(float(v), float(v - w), float(v + w)) for v, w in zip(values, widths, strict=True)]

    def smallest(self, name: str, freed: Sequence[str], level: float) -> float:
        """The smallest change of a parameter, alike in all its components, that is found in a share `POWER` of cases.

        The parameters `freed` have changed; the others have not.
        """
        held = self.held([other for other in freed if other != name])
        rows = self.rows([name])
        _, covariance, freedom = self._given(rows, self.rows([other for other in held if other != name]))
        along = np.ones(len(rows))
        deviation = 1.0 / np.sqrt(float(along @ _solve(covariance, along)))
        share = 0.5 * level / len(held)
        needed = np.sqrt(len(rows) * float(scipy.stats.f.isf(share, len(rows), freedom)))
        return float((needed + scipy.stats.t.ppf(POWER, freedom)) * deviation)

    def _given(
        self, rows: list[int], rest: list[int]
    ) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m m"], float]:
        """The changes in `rows` given none in the `rest`, their covariance, and its degrees of freedom."""
        total = self.before.covariance + self.after.covariance
        change, own = self.change, total[np.ix_(rows, rows)]
        names = [name for name in self.names if set(self.rows([name])) <= set(rest)]
        distance, freedom = self.distance(names if rest else [self.parameters[k] for k in rows])
        if not rest:
            return change[rows], own, max(1.0, freedom)
        cross = total[np.ix_(rest, rows)]
        weights = _solve(total[np.ix_(rest, rest)], cross)
        left = max(1.0, freedom - len(rest))
        wider = freedom / left * (1.0 + distance / freedom)
        return change[rows] - weights.T @ change[rest], wider * (own - cross.T @ weights), left


def _solve(matrix: Float[np.ndarray, "k k"], right: Float[np.ndarray, "k ..."]) -> Float[np.ndarray, "k ..."]:
    """matrix^-1 right of a covariance, scaled to its correlation first: parameters differ by many orders."""
    scale = np.sqrt(np.diag(matrix))
    scaled = right / (scale if right.ndim == 1 else scale[:, None])
    # by the pseudo-inverse: of two numbers that only differ together, the difference is known without error
    solved = np.linalg.pinv(matrix / np.outer(scale, scale), hermitian=True) @ scaled
    return np.asarray(solved / (scale if right.ndim == 1 else scale[:, None]))
