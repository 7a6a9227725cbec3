"""How small an effect the logs would have shown, and from what size on they tell it from the others.

To first order, an effect of size a moves the residuals by a s. What is free makes way, and leaves s' of its sensitivity
s. With the effect, -2 log likelihood is then less by a^2 s's' than without; its parameters cost the logarithm of the
volume that the logs leave of their prior. It is found where the difference is the evidence that an effect must bring:

    a^2 s's' = evidence needed + log volume

With another effect free to make way as well, the same equation gives the size from which on the two are told apart. So
nothing is simulated and nothing fitted. Where the effect is not linear in its size, the filter runs with it at several
sizes, and what changes is in the place of a s.

No model is right to the last digit: the filter allows it the force that counts as nothing missing (`relevant_forces`).
"""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.effects.actuator import LoopDelay
from diffdrive.effects.catalogue import EFFECTS
from tuning.diagnosis.candidate import WAVE, Candidate
from tuning.diagnosis.curvature import log_volume, solved
from tuning.diagnosis.fitting import Fitted, Fitter
from tuning.diagnosis.leftover import relevant_forces
from tuning.diagnosis.screening import DEARNESS
from tuning.diagnosis.shown import (
    Labels,
    Shown,
    Sized,
    possible_sizes,
    shown,
    sized,
    unusual_values,
    usual_values,
)

HALVINGS = 4  # of the distance between the sizes about a limit
AMPLITUDE = "amplitude"  # of a wave

Group = Sequence[int]  # columns of one size in one log: one, or cosine and sine
Products = Float[np.ndarray, "k k"]


class DetectionLimit(NamedTuple):
    """What the logs would have shown of an effect.

    From `size` on (SI, `unit`) it is seen; up to it, where the effect is the weaker the larger this parameter is
    (`weakens`); None: at no size that would be expected. `rival` is the effect that does most nearly the same, and
    `apart` the larger size from which on it is told from that one; None: at no such size. Without a rival, all that see
    it tell it apart.
    """

    effect: str
    parameter: str
    unit: str
    size: float | None
    weakens: bool
    rival: str | None
    apart: float | None


class Table(NamedTuple):
    """Products of what each effect does to the residuals, with those of every other."""

    products: Products
    places: Mapping[str, slice]  # of each effect's columns
    costs: Mapping[str, float]  # of each: what its parameters cost in evidence
    rivals: Mapping[str, Sequence[str]]  # of each: the others, but for those that are its bare self

    def of(self, name: str) -> Products:
        """Those of one effect."""
        return self.products[self.places[name], self.places[name]]

    def beside(self, name: str, rival: str) -> Products:
        """The same when a rival, whose numbers have a prior of one, makes way for it too."""
        own, other = self.places[name], self.places[rival]
        cross = self.products[other, own]
        return self.products[own, own] - cross.T @ solved(self.of(rival) + np.eye(len(cross)), cross)


def detection_limits(
    fitter: Fitter, fitted: Fitted, catalogue: Sequence[Candidate], needed: float
) -> list[DetectionLimit]:
    """Of each effect that a fit has not; `needed` is the evidence that one more must bring.

    None of a fit whose effect is stepped within the filter: there each number would take a filter of its own.
    """
    if fitted.model.coupled:
        return []
    fitted = fitter.under(fitted, np.maximum(fitted.process, relevant_forces(fitter, fitted)))
    if not np.all(np.isfinite(fitted.hessian)):
        return []
    members = [member.candidate for member in fitted.model.members]
    kinds = {one.name: one for one in reversed(catalogue) if not any(one.excludes(other) for other in members)}
    if not kinds:
        return []
    linear = {name: one for name, one in kinds.items() if _is_linear(one)}
    logs = fitted.model.logged.logs
    usual = {name: shown(fitter, fitted, one, usual_values(one, logs)) for name, one in linear.items()}
    others = {name: _searched(fitter, fitted, one, needed) for name, one in kinds.items() if name not in linear}
    table = _table(kinds, usual, others)
    limits: list[DetectionLimit] = []
    for name in kinds:
        if name in usual:
            limits += _of_amplitudes(fitter, fitted, kinds[name], usual[name], table, needed)
        else:
            limits.append(_of_sizes(fitter, kinds[name], others[name], table, needed))
    return limits


def _is_linear(candidate: Candidate) -> bool:
    return any(one.amplitude for one in candidate.parameters)


def _table(kinds: Mapping[str, Candidate], usual: Mapping[str, Shown], others: Mapping[str, Sized]) -> Table:
    columns = {name: one.columns for name, one in usual.items()} | {name: one.columns for name, one in others.items()}
    ends = np.cumsum([one.shape[1] for one in columns.values()])
    sizes = zip(columns.items(), ends, strict=True)
    places = {name: slice(int(end) - one.shape[1], int(end)) for (name, one), end in sizes}
    every = np.concatenate(list(columns.values()), axis=1)
    products = every.T @ every
    costs = {
        name: _volume(products[place, place]) if name in usual else _price(kinds[name])
        for name, place in places.items()
    }
    rivals = {name: [other for other in kinds if not one.excludes(kinds[other])] for name, one in kinds.items()}
    return Table(products, places, costs, rivals)


def _groups(labels: Labels) -> dict[str, list[Group]]:
    """The columns of each size by its parameter, log by log: cosine and sine are one; of waves the first harmonic."""
    groups: dict[str, dict[int | None, list[int]]] = {}
    for column, (parameter, log) in enumerate(labels):
        if parameter.name.startswith(WAVE[:2]) and parameter.name not in WAVE[:2]:
            continue
        name = WAVE[0] if parameter.name in WAVE[:2] else parameter.name
        groups.setdefault(name, {}).setdefault(log, []).append(column)
    return {name: list(each.values()) for name, each in groups.items()}


def _told_by(products: Products, groups: Sequence[Group]) -> float:
    """Evidence of one deviation of the prior, in every log alike, at the phase that shows least of it."""
    return float(sum(np.linalg.eigvalsh(products[np.ix_(group, group)])[0] for group in groups))


def _deviations(evidence: float, needed: float) -> float:
    """Size, in deviations of its prior, that brings the evidence that is needed."""
    return float(np.sqrt(max(needed, 0.0) / evidence)) if evidence > 0.0 else np.inf


def _volume(products: Products) -> float:
    return log_volume(products + np.eye(len(products)))


def _of_amplitudes(
    fitter: Fitter, fitted: Fitted, candidate: Candidate, usual: Shown, table: Table, needed: float
) -> Iterator[DetectionLimit]:
    """A limit for each amplitude, where the other numbers of the effect make it hardest to see."""
    name, own = candidate.name, table.of(candidate.name)
    logs = fitted.model.logged.logs
    unusual = [shown(fitter, fitted, candidate, at).columns for at in unusual_values(candidate, logs)]
    harder = [columns.T @ columns for columns in unusual]
    beside = {other: table.beside(name, other) for other in table.rivals[name]}
    for parameter, groups in _groups(usual.labels).items():
        size, *others = (_deviations(_told_by(one, groups), needed + _volume(one)) for one in (own, *harder))
        worst = max([size, *others])
        told = {
            other: _deviations(_told_by(left, groups), needed + table.costs[name] - table.costs[other])
            for other, left in beside.items()
        }
        rival = max(told, key=lambda one: told[one], default=None)
        apart = worst if rival is None else worst * max(1.0, told[rival] / size)
        spread = next(one.spread for one in candidate.parameters if one.name == parameter)
        least = candidate.least if parameter == WAVE[0] else 0.0
        size, apart = (max(spread * one, least) for one in (worst, apart))
        yield _limit(fitter, candidate, parameter, size, False, rival, apart)


def _searched(fitter: Fitter, fitted: Fitted, candidate: Candidate, needed: float) -> Sized:
    """An effect at sizes that close in on the one that brings what is needed, from the weakest to the strongest."""
    found = sized(fitter, fitted, candidate, possible_sizes(candidate))
    for _ in range(HALVINGS):
        found = _by_strength(found)
        seen = _seen_from(found.gains - _price(candidate), needed)
        if seen in (0, len(found.sizes)):
            break
        more = sized(fitter, fitted, candidate, [0.5 * (found.sizes[seen - 1] + found.sizes[seen])])
        found = Sized(np.concatenate([found.columns, more.columns], axis=1), np.r_[found.sizes, more.sizes])
    return _by_strength(found)


def _by_strength(found: Sized) -> Sized:
    order = np.argsort(found.sizes)
    if found.gains[order[0]] > found.gains[order[-1]]:
        order = order[::-1]
    return Sized(found.columns[:, order], found.sizes[order])


def _price(candidate: Candidate) -> float:
    """What the numbers of an effect without amplitudes cost."""
    return DEARNESS * len(candidate.parameters)


def _seen_from(evidence: Float[np.ndarray, " k"], needed: float) -> int:
    """The first of several sizes, from the weakest to the strongest, from which on all bring what is needed."""
    weak = np.flatnonzero(~(evidence >= needed))
    return int(weak[-1]) + 1 if weak.size else 0


def _of_sizes(fitter: Fitter, candidate: Candidate, found: Sized, table: Table, needed: float) -> DetectionLimit:
    """The limit of an effect that is not linear in its size."""
    name, one, price = candidate.name, candidate.parameters[0], table.costs[candidate.name]
    values = [*(one.value(size) for size in found.sizes), np.inf]
    seen = _seen_from(found.gains - price, needed)
    told = {
        other: _seen_from(np.diag(table.beside(name, other)) - price + table.costs[other], needed)
        for other in table.rivals[name]
    }
    rival = max(told, key=lambda one: told[one], default=None)
    apart = seen if rival is None else max(seen, told[rival])
    return _limit(fitter, candidate, one.name, values[seen], values[0] > values[-2], rival, values[apart])


def _limit(
    fitter: Fitter, candidate: Candidate, parameter: str, size: float, weakens: bool, rival: str | None, apart: float
) -> DetectionLimit:
    """In the units of the catalogue; delays in periods of the controller."""
    fields = {one.name: one.metadata["quantity"] for one in dataclasses.fields(EFFECTS[candidate.name])}
    per = float(fitter.logged.thinning) if candidate.effect is LoopDelay else 1.0
    known, told = (per * one if np.isfinite(one) else None for one in (size, apart))
    label = AMPLITUDE if parameter == WAVE[0] else parameter
    rival = None if told == known else rival
    return DetectionLimit(candidate.name, label, fields[parameter].unit, known, weakens, rival, told)
