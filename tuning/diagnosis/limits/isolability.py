"""Which effects the logs would show and yet not tell apart, and up to which size.

Amounts a of one effect move the residuals by D a, of another by D' a'. What is free makes way for both, and leaves the
products S of their columns (`reduced`). In the log of a machine that has the first, -2 log likelihood falls by
a' S (S + 1)^-1 S a with that effect, and with the other in its place by as much with the products of both in the place
of the first and last S. The other is excluded where the difference, less that of the volumes that the logs leave of
their priors, is what excludes a hypothesis (`levels.DECLARED`). So nothing is simulated and nothing fitted, and it is
said which effects another motion would have to tell apart.

Only effects that are there by degrees are compared: those whose residuals are linear in an amount.
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.reduced import reduced
from tuning.diagnosis.levels import EXCLUDED, LACKING, LEFT
from tuning.diagnosis.limits.detection import (
    UNEXPECTED,
    ByAmount,
    DetectionLimit,
    Group,
    Products,
    amplitude_groups,
    deviations,
    explained,
    gain_per_deviation,
    limit_of,
    volume,
)


class Rivalry(NamedTuple):
    """An effect that would be seen from a size on, and told from its closest rival from a larger one on.

    Sizes are in SI units; `isolable` is None where it is at no size that would be expected. `share` is how much of what
    the effect does in the logs the rival would do, too, in mean square.
    """

    seen: DetectionLimit
    rival: str
    share: float
    isolable: float | None


class _Columns(NamedTuple):
    """Which columns of all are those of an effect, at one choice of its other numbers."""

    effect: ByAmount
    at: slice


def rivalries(
    fitter: Fitter, fitted: Fitted, amounts: Sequence[ByAmount], limits: Sequence[DetectionLimit]
) -> list[Rivalry]:
    """Of each effect that would be seen, by its limit, and that another would explain as well up to a larger size.

    `amounts` are `detection.small_amounts` of the fit, which is that of `detection.allowed`.
    """
    if not amounts:
        return []
    every = [one for effect in amounts for one in effect.answers]
    ends = np.cumsum([len(one.labels) for one in every])
    slices = [slice(int(end) - len(one.labels), int(end)) for one, end in zip(every, ends, strict=True)]
    owners = [effect for effect in amounts for _ in effect.answers]
    columns = [_Columns(owner, at) for owner, at in zip(owners, slices, strict=True)]
    second = np.concatenate([one.second for one in every], axis=1)
    products = reduced(fitted, np.concatenate([one.residuals for one in every], axis=1)).curvature + second.T @ second
    usual = {id(one.effect): one for one in reversed(columns)}
    seen = {(one.effect, one.parameter): one for one in limits if one.size is not None}
    return [one for effect in amounts for one in _of(fitter, usual[id(effect)], columns, products, seen)]


def _of(
    fitter: Fitter,
    mine: _Columns,
    every: Sequence[_Columns],
    products: Products,
    seen: Mapping[tuple[str, str], DetectionLimit],
) -> Iterator[Rivalry]:
    """Of each amplitude of an effect with its closest rival, where that hides something."""
    candidate = mine.effect.candidate
    known = candidate.by_name
    rivals = [one for one in every if one.effect.candidate.name != candidate.name]
    for parameter, groups in amplitude_groups(mine.effect.labels).items():
        spread = known[parameter].spread
        sizes = [spread * _isolable_size(products, mine, other, groups) for other in rivals]
        hardest = int(np.argmax(sizes)) if sizes else 0
        isolable = limit_of(fitter, candidate, parameter, sizes[hardest] if sizes else None)
        limit = seen.get((isolable.effect, isolable.parameter))
        if limit is None or isolable.size is None or isolable.size <= (limit.size or 0.0):
            continue
        yield Rivalry(
            limit,
            rivals[hardest].effect.candidate.name,
            _share(products, mine, rivals[hardest], groups),
            isolable.size if sizes[hardest] <= UNEXPECTED * spread else None,
        )


def _isolable_size(products: Products, mine: _Columns, other: _Columns, groups: Sequence[Group]) -> float:
    """The size, in deviations of its prior, from which on the other effect is excluded.

    The temperature of a verdict is a number, or a share of the evidence gained: both must be exceeded.
    """
    own, theirs = products[mine.at, mine.at], products[other.at, other.at]
    by_itself, instead = explained(own, own), explained(products[mine.at, other.at], theirs)
    dearer = volume(own) - volume(theirs)
    return max(
        deviations(gain_per_deviation(by_itself - instead, groups), LACKING + dearer),
        deviations(gain_per_deviation((1.0 - EXCLUDED * LEFT) * by_itself - instead, groups), dearer),
    )


def _share(products: Products, mine: _Columns, other: _Columns, groups: Sequence[Group]) -> float:
    """Of the mean square of what the effect does, how much the other does as well; of waves at all phases together."""
    at = np.array([column for group in groups for column in group]) + mine.at.start
    shared = np.linalg.lstsq(products[other.at, other.at], products[other.at, at])[0]
    return float(np.clip(np.trace(products[at, other.at] @ shared) / np.trace(products[np.ix_(at, at)]), 0.0, 1.0))
