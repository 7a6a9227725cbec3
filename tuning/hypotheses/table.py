"""One table of what may act, beside free functions of what a force may depend on.

A model that lacks an effect is wrong all along, and not by white noise: what it lacks depends on place, speed, time or
command. A filter that takes its errors for white counts each of them: every effect that bends the innovations alike
gains thousands, and nominal parameters are drawn far off. So beside what is free stand functions of these
(`dependence.families`), whose scale is integrated. An effect is worth what it explains better, with its few numbers,
than they do.

With residuals r, their derivatives by what is free and by the corners of the functions K, and by the amounts of an
effect D, all in units of their priors, -2 log evidence of the effect over that of the functions alone is, at one scale,

    log det (1 + S) - g' (1 + S)^-1 g ,   S = D'D - D'K H^-1 K'D ,   g = D'r - D'K H^-1 (K'r + u) ,   H = K'K + 1 .

So one pass of the filter's answers gives every column, and no hypothesis needs another.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import logsumexp

from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.gap.dependence import SCALES, corner_answers, families
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import Vector
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.diagnosis.selection.screening import (
    DEARNESS,
    Values,
    begin,
    joined,
    sensitivities,
    sensitivities_of_one_mass,
)
from tuning.diagnosis.selection.starting_points import starting_points

PAST = "past commands"  # functions of these are what a delay or a lag does: beside them neither is worth anything

ByScale = Float[np.ndarray, " scales"]


class Entry(NamedTuple):
    """An effect at values of its numbers: what it is worth beside the functions, and where a fit of it begins."""

    candidate: Candidate
    values: Values
    evidence: float  # 2 log of how much likelier the logs are with it
    rest: Vector  # u of what was free before, moved along


class Table:
    """What is free and the functions over one fit, ready to make way for an effect."""

    def __init__(self, fitted: Fitted, functions: Float[np.ndarray, "m f"]) -> None:
        self.fitted, self.free = fitted, fitted.jacobian.shape[1]
        self.known = np.concatenate([fitted.jacobian, functions], axis=1)
        products, corners = self.known.T @ self.known, functions.shape[1]
        scales = SCALES if corners else np.ones(1)
        self.units = [np.r_[np.ones(self.free), np.full(corners, scale)] for scale in scales]
        found = [np.linalg.eigh(products * unit[:, None] * unit + np.eye(unit.size)) for unit in self.units]
        self.eigenvalues = [np.maximum(values, 1.0) for values, _ in found]
        self.eigenvectors = [vectors for _, vectors in found]
        self.volumes: ByScale = np.array([np.sum(np.log(values)) for values in self.eigenvalues])
        self.here = self._whitened(self._slope(fitted.residual))
        self.alone = self._evidences(self.here)
        self.evidence = integrated(self.alone)  # of the functions and a step of what is free, over neither

    def _slope(self, residual: Float[np.ndarray, " m"]) -> Vector:
        found = self.known.T @ residual
        found[: self.free] += self.fitted.theta
        return found

    def _whitened(self, right: Float[np.ndarray, "k ..."]) -> list[Float[np.ndarray, "k ..."]]:
        """H^-1/2 of it, at each scale."""
        return [
            ((vectors.T @ (right.T * unit).T).T / np.sqrt(values)).T
            for values, vectors, unit in zip(self.eigenvalues, self.eigenvectors, self.units, strict=True)
        ]

    def _evidences(self, whitened: Sequence[Vector]) -> ByScale:
        return np.array([one @ one for one in whitened]) - self.volumes

    def _moved(self, whitened: Sequence[Vector], weights: ByScale) -> Vector:
        """By how much what is free makes way."""
        steps = [
            -unit * (vectors @ (one / np.sqrt(values)))
            for one, vectors, values, unit in zip(
                whitened, self.eigenvectors, self.eigenvalues, self.units, strict=True
            )
        ]
        return np.einsum("s,sk->k", weights, np.array(steps))[: self.free]

    def of_change(self, residual: Float[np.ndarray, " m"], cost: float) -> tuple[float, Vector]:
        """Evidence over the table's own where residuals and cost are others; and by how much what is free moves."""
        whitened = self._whitened(self._slope(residual))
        every = self._evidences(whitened)
        return self.fitted.cost - cost + integrated(every) - self.evidence, self._moved(whitened, shares(every))

    def of_columns(
        self, columns: Float[np.ndarray, "m n"], blocks: Sequence[slice]
    ) -> list[tuple[float, Vector, Vector]]:
        """For each block of columns alone: evidence over the table's own, the amounts, and what is free moves."""
        cross, right = self._whitened(self.known.T @ columns), columns.T @ self.fitted.residual
        curvatures = [columns.T @ columns - one.T @ one for one in cross]
        slopes = [right - one.T @ here for one, here in zip(cross, self.here, strict=True)]
        found = []
        for block in blocks:
            at_scales = [
                _at_scale(curvature[block, block], slope[block])
                for curvature, slope in zip(curvatures, slopes, strict=True)
            ]
            every, amounts = self.alone + np.array([gain for gain, _ in at_scales]), [amount for _, amount in at_scales]
            there = [here + one[:, block] @ by for here, one, by in zip(self.here, cross, amounts, strict=True)]
            weights = shares(every)
            amount = np.einsum("s,sk->k", weights, np.array(amounts))
            found.append((integrated(every) - self.evidence, amount, self._moved(there, weights)))
        return found


def _at_scale(curvature: Float[np.ndarray, "n n"], slope: Vector) -> tuple[float, Vector]:
    """Evidence of some columns at one scale of the functions, and their amounts."""
    values, vectors = np.linalg.eigh(curvature + np.eye(slope.size))
    values, part = np.maximum(values, 1.0), vectors.T @ slope
    return float(np.sum(part**2 / values) - np.sum(np.log(values))), -vectors @ (part / values)


def integrated(evidences: ByScale) -> float:
    """Evidence where every scale of the functions is as likely as the others."""
    return 2.0 * float(logsumexp(0.5 * evidences) - np.log(len(evidences)))


def shares(evidences: ByScale) -> ByScale:
    """How likely each scale is then."""
    return np.exp(0.5 * evidences - logsumexp(0.5 * evidences))


def table_of(fitted: Fitted, at: Setting) -> Table:
    """The free functions beside a fit; none beside another friction before sliding, where each takes a filter."""
    if not is_one_mass(fitted):
        return Table(fitted, np.zeros((fitted.residual.size, 0)))
    free = [corner_answers(fitted, family) for family, _ in families(fitted, at) if family.of != PAST]
    return Table(fitted, np.concatenate(free, axis=1))


def is_one_mass(fitted: Fitted) -> bool:
    """Whether small forces have their effect by a linear recursion along the course, if but below a resonance."""
    return fitted.model.screw or not fitted.model.coupled


def entries(fitter: Fitter, table: Table, candidate: Candidate, points: Sequence[Values]) -> list[Entry]:
    """What an effect would be worth at points of its grid."""
    if any(one.amplitude for one in candidate.parameters):
        return _by_amount(table, candidate, points)
    return [by_change(fitter, table, candidate, values) for values in points]


def grid(table: Table, candidate: Candidate) -> list[Values]:
    """Where an effect is looked for."""
    return starting_points(table.fitted, candidate)


def _by_amount(table: Table, candidate: Candidate, points: Sequence[Values]) -> list[Entry]:
    """Of an effect that is there by degrees, at the amounts that explain most."""
    if not points:
        return []
    by_amounts = sensitivities_of_one_mass if is_one_mass(table.fitted) else sensitivities
    columns, labels = zip(*(by_amounts(table.fitted, candidate, values) for values in points), strict=True)
    ends = np.cumsum([one.shape[1] for one in columns])
    blocks = [slice(int(end) - one.shape[1], int(end)) for end, one in zip(ends, columns, strict=True)]
    gains = table.of_columns(np.concatenate(columns, axis=1), blocks)
    found = []
    for values, of, (evidence, amounts, moved) in zip(points, labels, gains, strict=True):
        full = dict(values)
        for (one, log), amount in zip(of, amounts, strict=True):
            row = full.setdefault(one.name, np.zeros(table.fitted.model.logged.logs))
            row[slice(None) if log is None else log] = amount * one.spread
        found.append(Entry(candidate, full, evidence, table.fitted.theta + moved))
    return found


def by_change(fitter: Fitter, table: Table, candidate: Candidate, values: Values) -> Entry:
    """Of an effect that is not linear in its size, by a filter that has it."""
    fitted, model = table.fitted, joined(table.fitted.model, candidate, values)
    own = begin(model, values)
    point = fitter.at(model, np.r_[fitted.theta, own], fitted.process_noise, fitted.filtered.trajectory)
    if not np.isfinite(point.cost):
        return Entry(candidate, values, -np.inf, fitted.theta)
    evidence, moved = table.of_change(fitter.residuals(point)[0], point.cost)
    return Entry(candidate, values, evidence - DEARNESS * own.size, fitted.theta + moved)
