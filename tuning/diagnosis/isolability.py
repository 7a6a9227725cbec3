"""Which effects the logs would show and yet not tell apart, and up to which size.

Amounts a of one effect move the residuals by D a, of another by D' a'. What is free makes way for both, and leaves the
products S of their columns (`reduced`). In the log of a machine that has the first, -2 log likelihood falls by
a' S (S + 1)^-1 S a with that effect, and with the other in its place by as much with the products of both in the place
of the first and last S. The other is excluded where the difference, less that of the volumes that the logs leave of
their priors, is what excludes a hypothesis (`verdict.DECLARED`). So nothing is simulated and nothing fitted, and it is
said which effects another motion would have to tell apart.

Only effects that are there by degrees are compared: those whose residuals are linear in an amount.
"""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from tuning.diagnosis.candidate import WAVE
from tuning.diagnosis.detection import (
    UNEXPECTED,
    ByAmount,
    DetectionLimit,
    Group,
    Products,
    allowed,
    amplitude_groups,
    deviations,
    explained,
    gain_per_deviation,
    is_alone,
    limit_of,
    volume,
)
from tuning.diagnosis.fitting import Fitted, Fitter
from tuning.diagnosis.reduced import reduced
from tuning.diagnosis.verdict import DECLARED

EXCLUDED = -2.0 * float(np.log(DECLARED))  # of -2 log likelihood, by which a rival is no alternative


class Rivalry(NamedTuple):
    """An effect that would be seen from a size on, and told from its closest rival from a larger one on.

    Sizes are in SI units; `told` is None where it is at no size that would be expected. `share` is how much of what the
    effect does in the logs the rival would do, too, in mean square.
    """

    seen: DetectionLimit
    rival: str
    share: float
    told: float | None


class _Columns(NamedTuple):
    """Which columns of all are those of an effect, at one choice of its other numbers."""

    effect: ByAmount
    at: slice


def rivalries(fitter: Fitter, fitted: Fitted, amounts: Sequence[ByAmount], needed: float) -> list[Rivalry]:
    """Of each effect that would be seen, and that another would explain as well up to a larger size.

    `amounts` are `detection.small_amounts` of the fit, and `needed` is the evidence that an effect must bring.
    """
    if not amounts:
        return []
    fitted = allowed(fitter, fitted)
    every = [one for effect in amounts for one in effect.answers]
    ends = np.cumsum([len(one.labels) for one in every])
    slices = [slice(int(end) - len(one.labels), int(end)) for one, end in zip(every, ends, strict=True)]
    owners = [effect for effect in amounts for _ in effect.answers]
    columns = [_Columns(owner, at) for owner, at in zip(owners, slices, strict=True)]
    second = np.concatenate([one.second for one in every], axis=1)
    products = reduced(fitted, np.concatenate([one.residuals for one in every], axis=1)).curvature + second.T @ second
    usual = {id(one.effect): one for one in reversed(columns)}
    return [one for effect in amounts for one in _of(fitter, fitted, usual[id(effect)], columns, products, needed)]


def _of(
    fitter: Fitter, fitted: Fitted, mine: _Columns, every: Sequence[_Columns], products: Products, needed: float
) -> Iterator[Rivalry]:
    """Of each amplitude of an effect with its closest rival, where that hides something."""
    candidate, own = mine.effect.candidate, products[mine.at, mine.at]
    known, by_itself = {one.name: one for one in candidate.parameters}, explained(own, own)
    rivals = [one for one in every if one.effect.candidate.name != candidate.name]
    for parameter, groups in amplitude_groups(mine.effect.labels).items():
        spread, least = known[parameter].spread, candidate.least if parameter == WAVE[0] else 0.0
        seen = max(spread * deviations(gain_per_deviation(by_itself, groups), needed + volume(own)), least)
        if seen > UNEXPECTED * spread or not is_alone(
            fitted, candidate, mine.effect.usual, parameter, UNEXPECTED * spread
        ):
            continue
        sizes = [spread * _told(products, mine, other, groups, by_itself) for other in rivals]
        hardest = int(np.argmax(sizes)) if sizes else 0
        if not sizes or sizes[hardest] <= seen:
            continue
        told = sizes[hardest] if sizes[hardest] <= UNEXPECTED * spread else None
        yield Rivalry(
            limit_of(fitter, candidate, parameter, seen),
            rivals[hardest].effect.candidate.name,
            _share(products, mine, rivals[hardest], groups),
            limit_of(fitter, candidate, parameter, told).size,
        )


def _told(products: Products, mine: _Columns, other: _Columns, groups: Sequence[Group], by_itself: Products) -> float:
    """The size, in deviations of its prior, from which on the other effect is excluded."""
    theirs = products[other.at, other.at]
    instead = explained(products[mine.at, other.at], theirs)
    dearer = volume(products[mine.at, mine.at]) - volume(theirs)
    return deviations(gain_per_deviation(by_itself - instead, groups), EXCLUDED + dearer)


def _share(products: Products, mine: _Columns, other: _Columns, groups: Sequence[Group]) -> float:
    """Of the mean square of what the effect does, how much the other does as well; of waves at all phases together."""
    at = np.array([column for group in groups for column in group]) + mine.at.start
    shared = np.linalg.lstsq(products[other.at, other.at], products[other.at, at])[0]
    return float(np.clip(np.trace(products[at, other.at] @ shared) / np.trace(products[np.ix_(at, at)]), 0.0, 1.0))
