"""What a search ended with, and how two ways of it compare."""

from typing import NamedTuple, Optional

from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.goodness_of_fit import (
    comparable_parameters,
    is_implausible,
    max_prior_deviation,
    restores_nominal,
)
from tuning.diagnosis.levels import COARSE, DETAILS, STRAINED, WORTH
from tuning.diagnosis.selection.search import Round, excluding


class Explanation(NamedTuple):
    """The recalibrated drive and the effects found, one round for each."""

    base: Fitted
    rounds: list[Round]
    best: Fitted
    other: Optional["Explanation"] = None  # the way that was searched too and ended no better

    @property
    def named(self) -> set[str]:
        """The effects that were added."""
        return {one.name for one in self.best.model.added_candidates}

    @property
    def accepted(self) -> list[Round]:
        """The rounds whose effects were added."""
        return self.rounds[: self.best.model.added]


def last_outweighs_the_rest(found: Explanation) -> bool:
    """Whether the last effect brought more than all before it together."""
    last = found.rounds[found.best.model.added - 1]
    return last.before.evidence - last.fits[0].evidence > found.base.evidence - last.before.evidence


def is_better(base: Fitted, one: Fitted, other: Fitted) -> bool:
    """Whether `one` is the better end: never if only it needs impossible parameters. If only `other` does, `one` may
    lack `DETAILS` of what that explains.
    """
    if is_implausible(one, other):
        return False
    may_lack = DETAILS * max(base.evidence - other.evidence, 0.0) if is_implausible(other, one) else 0.0
    return one.evidence < other.evidence + may_lack


def other_first(found: Explanation) -> Round | None:
    """The first round with another effect in front; None where there is none that could be meant.

    Where what was found leaves a nominal parameter moved far, it is one that brings it back: until a tilt is known,
    say, nothing fits a loose screw that it holds to one side. Elsewhere it is one that explains nearly as much: of two
    effects, the second is found more easily beside one of them than beside the other.
    """
    if not found.best.model.added:
        return None
    first = found.rounds[0]
    best, *others = first.fits

    def gain(one: Fitted) -> float:
        return first.before.evidence - one.evidence

    def no_further(one: Fitted) -> bool:
        among = comparable_parameters(one, best)
        return max_prior_deviation(one, among) < max(STRAINED, max_prior_deviation(best, among))

    bringing_back = [one for one in others if restores_nominal(one, found.best)]
    near = [one for one in others if gain(one) > (1.0 - COARSE) * gain(best) and no_further(one)]
    for one in [*bringing_back, *near]:
        if gain(one) > WORTH:
            return first._replace(fits=[one, *excluding(first.fits, [one])], rivals=1, allowance=0.0, enough=WORTH)
    return None
