"""What each effect of the catalogue would do to the residuals of a fit, once all that is free has made way.

An effect that is linear in its amplitude has its sensitivity there. Of another the filter is run at several sizes, and
what changes is taken. Behind a second encoder, what it would see counts as residuals too.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from tuning.diagnosis.candidate import Candidate
from tuning.diagnosis.curvature import solved
from tuning.diagnosis.fitting import Fitted, Fitter, Point
from tuning.diagnosis.model import Vector, effect_in_lanes
from tuning.diagnosis.priors import ITSELF, Parameter
from tuning.diagnosis.screening import Values, begin, joined, sensitivities
from tuning.diagnosis.second_encoder import foreseen, seen_by

EITHER = (-1.0, 1.0)  # deviations of its prior, to which each parameter is moved from its usual value
SIZES = np.linspace(-8.0, 4.0, 7)  # deviations of the prior, at which an effect that is not linear in its size is tried
DECADES = np.geomspace(1e-4, 4.0, 5)  # the same of a size that is normal about zero
INSIDE = 1e-3  # of a bound, by which a size is inside it

Columns = Float[np.ndarray, "m k"]
Labels = Sequence[tuple[Parameter, int | None]]  # of columns: a parameter, and of which log; None: of all


class Shown(NamedTuple):
    """What a candidate does to the residuals, per deviation of its prior: a column for each amplitude and log."""

    columns: Columns
    labels: Labels


class Sized(NamedTuple):
    """What a candidate does to the residuals at several sizes, in deviations of its prior: a column for each."""

    columns: Columns
    sizes: Vector

    @property
    def gains(self) -> Vector:
        """What -2 log likelihood falls by at each size, where the machine has the effect."""
        return np.sum(self.columns**2, axis=0)


def usual_values(candidate: Candidate, logs: int) -> Values:
    """What is no amplitude at the middle of its prior; what has no prior, as the grid has it."""
    middle = {one.name: one.middle for one in candidate.parameters if not one.amplitude}
    return {name: np.full(logs, value) for name, value in (candidate.grid[0] | middle).items()}


def unusual_values(candidate: Candidate, logs: int) -> list[Values]:
    """The usual values with each of them moved by a deviation of its prior, within its bounds; times stay."""
    usual, points = usual_values(candidate, logs), []
    for one in candidate.parameters:
        if not (one.amplitude or one.session):
            moved = (usual | {one.name: np.full(logs, one.value(by))} for by in EITHER)
            points += [values for values in moved if _within(candidate, one.name, float(values[one.name][0]))]
    return points


def _within(candidate: Candidate, name: str, value: float) -> bool:
    return all(low < value < high for bound, low, high in candidate.bounds if bound == name)


def made_way(fitted: Fitted, columns: Columns) -> Columns:
    """Sensitivities when what is free has made way.

    With the curvature H = J'J + 1 of what is free, c'c - c'J H^-1 J'c is the product of what is left, c - J w, and of
    w = H^-1 J'c itself, which costs its prior.
    """
    way = solved(fitted.hessian, fitted.jacobian.T @ columns)
    return np.vstack([columns - fitted.jacobian @ way, way])


def shown(fitter: Fitter, fitted: Fitted, candidate: Candidate, values: Values) -> Shown:
    """What an effect with amplitudes does."""
    columns, labels = sensitivities(fitted, candidate, values)
    owner = fitted.model.logged.owner
    beside = np.zeros((0, len(labels)))
    if fitter.twist is not None and candidate.twists:
        seen = []
        for one, log in labels:
            here = np.array([one.spread if log in (None, k) else 0.0 for k in range(fitted.model.logged.logs)])
            effect = effect_in_lanes(candidate.effect, values | {one.name: here}, owner)
            seen.append(_seen(fitter, foreseen((effect,), fitted.track)))
        beside = np.stack(seen, axis=1)
    return Shown(_stacked(fitter, made_way(fitted, columns), beside), labels)


def sized(fitter: Fitter, fitted: Fitted, candidate: Candidate, sizes: ArrayLike) -> Sized:
    """What an effect without amplitudes does at sizes of its first parameter, all else as usual; beyond what it does
    where it is `bare`.
    """
    one, logs = candidate.parameters[0], fitted.model.logged.logs
    usual = usual_values(candidate, logs)
    model = joined(fitted.model, candidate)

    def at(value: float) -> Point:
        u = np.r_[fitted.u, begin(model, usual | {one.name: np.full(logs, value)})]
        return fitter.at(model, u, fitted.process, fitted.track.course)

    there = fitter.at(fitted.model, fitted.u, fitted.process, fitted.track.course)
    there = there if candidate.bare is None else at(candidate.bare)
    columns, beside = [], []
    for point in (at(one.value(size)) for size in np.asarray(sizes, float)):
        columns.append(_change(fitter, there, point))
        if fitter.twist is not None and candidate.twists:
            beside.append(_seen(fitter, foreseen(model.effects(point.u), point.track)))
    also = np.stack(beside, axis=1) if beside else np.zeros((0, len(columns)))
    return Sized(_stacked(fitter, made_way(fitted, np.stack(columns, axis=1)), also), np.asarray(sizes))


def possible_sizes(candidate: Candidate) -> Vector:
    """Sizes of the first parameter at which a candidate without amplitudes is tried, in deviations of its prior: evenly
    over what is expected, and just inside of its bounds.
    """
    one = candidate.parameters[0]
    sizes = DECADES if one.scale is ITSELF else SIZES
    ends = [
        one.standard(end)
        for name, low, high in candidate.bounds
        if name == one.name
        for end in (low * (1.0 + INSIDE), high * (1.0 - INSIDE))
        if 0.0 < end < np.inf
    ]
    every = np.unique([*sizes, *(end for end in ends if sizes[0] < end < sizes[-1])])
    return np.array([size for size in every if _within(candidate, one.name, one.value(size))])


def _change(fitter: Fitter, before: Point, after: Point) -> Vector:
    """Of the residuals; none where either filter was lost."""
    (old, kept), (new, also) = fitter.residuals(before), fitter.residuals(after)
    return np.where((kept > 0.0) & (also > 0.0), new - old, 0.0)


def _seen(fitter: Fitter, expected: Float[np.ndarray, "lanes n"]) -> Vector:
    assert fitter.twist is not None
    return seen_by(fitter.twist, expected, fitter.logged.sampling.period)


def _stacked(fitter: Fitter, columns: Columns, beside: Columns) -> Columns:
    """With what a second encoder sees, if there is one."""
    if fitter.twist is None:
        return columns
    rows = np.zeros((fitter.twist.value.size, columns.shape[1]))
    rows[: len(beside)] = beside
    return np.vstack([columns, rows])
