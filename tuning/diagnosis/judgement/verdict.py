"""What the evidence says: none, an effect, or structure that nothing in the catalogue explains; and how sure that is.

The evidence of a fit takes the model's form for granted, and a model that is a little wrong in form loses more than one
of another kind gains. So two hypotheses are told apart by their evidence only as far as the better of them explains
the logs to the noise: the temperature of the probabilities is a share of what was gained, larger where much is left.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.special import expit

from tuning.diagnosis.fits.fitted import Fitted, last_candidate
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import (
    is_complete,
    is_implausible,
    largest_deviation_says,
    max_prior_deviation,
    restores_nominal,
    share_left,
)
from tuning.diagnosis.levels import COARSE, COLDEST, DECLARED, DETAILS, IMPOSSIBLE, LEFT, STRAINED
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import Round

ROUGH = 0.08  # of the evidence, times the share left: what the temperature has beside `LEFT`
TOLD = 0.005  # unexplained, from which on it is said
SHARPNESS = 3.0  # by which factor more or less makes it sure
UNSURE = 0.5  # the most that a cause is believed where the logs cannot tell it; where much is left, how sure one is
TAKEN = 0.9  # that surely takes away so much of the force that is missing in what is held out
SUREST = 0.97  # the most that any is: fits end in false minima, and machines have what no catalogue lists
NEAREST = 0.2  # how sure an effect without rivals is where much is left: about one in five of them acts


class Belief(NamedTuple):
    """One effect and how sure it is."""

    effect: str
    confidence: float
    found: bool  # part of the explanation
    round: int  # in which it was looked for
    gain: float  # in evidence, over what was known before that round
    fitted: Fitted
    alternatives: list[str]  # that these logs cannot exclude in its place


class Verdict(NamedTuple):
    """What the logs say."""

    verdict: str  # "none", "effect" or "unknown"
    beliefs: list[Belief]  # one of each effect: what was found first, then the surest
    unexplained: float  # share of the gap beyond the noise that nothing explains
    says: str

    def and_says(self, more: str) -> "Verdict":
        """The same, with something to add."""
        return self._replace(says=f"{self.says}; {more}")

    def downgraded(self, why: str) -> "Verdict":
        """The same causes, none of them sure."""
        joined = "but" if self.verdict == "effect" else "and"
        return self._replace(verdict="unknown", beliefs=_unsure(self.beliefs)).and_says(f"{joined} {why}")


def _at_most(most: float, beliefs: list[Belief]) -> list[Belief]:
    return [one._replace(confidence=min(one.confidence, most)) for one in beliefs]


def _unsure(beliefs: list[Belief]) -> list[Belief]:
    return _at_most(UNSURE, beliefs)


def _probabilities(gains: Float[np.ndarray, " k"], left: float) -> Float[np.ndarray, " k"]:
    best = float(np.max(gains, initial=0.0))
    temperature = max(COLDEST, (LEFT + ROUGH * left) * best)
    weights = np.exp((gains - np.max(gains)) / temperature)
    return weights / np.sum(weights)


def _believed(looked: Round, number: int, left: float, found: bool, certain: float) -> list[Belief]:
    """Every candidate of a round that was fitted; `certain` is how sure it is that one of them acts."""
    gains = np.array([looked.before.evidence - one.evidence for one in looked.fits])
    shares = np.r_[_probabilities(gains[: looked.rivals], left), np.zeros(len(gains) - looked.rivals)]
    names = [last_candidate(one).name for one in looked.fits]
    close = [name for name, share in zip(names, shares, strict=True) if share > DECLARED * shares[0]]
    beliefs = []
    for k, (name, share, one) in enumerate(zip(names, shares, looked.fits, strict=True)):
        rivals = [other for other in close if other != name]
        beliefs.append(Belief(name, float(certain * share), found and k == 0, number, float(gains[k]), one, rivals))
    return beliefs


def _shared(
    beliefs: list[Belief], found: Explanation, left: float, certain: float, surely: Sequence[float]
) -> list[Belief]:
    """The beliefs with what the search found on its other way as a rival of what differs from it; `surely` is how sure
    each effect that was found is before that, `certain` all others.
    """
    if found.other is None or is_implausible(found.other.best, found.best):
        return beliefs
    mine, theirs = found.named - found.other.named, found.other.named - found.named
    gains = np.array([found.base.evidence - one.best.evidence for one in (found, found.other)])
    shares = _probabilities(gains, left)
    rivals = sorted(theirs) if shares[1] > DECLARED * shares[0] else []
    shared = [
        one._replace(  # its own round may have shared with the same rival: the less counts, not both
            confidence=min(one.confidence, float(surely[one.round] * shares[0])),
            alternatives=[*dict.fromkeys([*one.alternatives, *rivals])],
        )
        if one.found and one.effect in mine
        else one
        for one in beliefs
    ]
    sure = float(certain * shares[1])
    for number, looked in enumerate(found.other.accepted):
        fitted = looked.fits[0]
        name = last_candidate(fitted).name
        if name in theirs:
            gain = float(looked.before.evidence - fitted.evidence)
            shared = [one for one in shared if (one.effect, one.round) != (name, number)]
            shared.append(Belief(name, sure, False, number, gain, fitted, sorted(mine) if rivals else []))
    return shared


def _one_of_each(beliefs: list[Belief]) -> list[Belief]:
    """Of each effect, which every round may have fitted anew, what was found of it, else what is surest."""
    kept: dict[str, Belief] = {}
    for one in sorted(beliefs, key=lambda one: (not one.found, -one.confidence)):
        kept.setdefault(one.effect, one)
    return list(kept.values())


def _may_leave(best: Fitted) -> float:
    """The share of what was missing that an explanation may leave.

    A coarse effect alone may leave its own details; a second effect would be believed for fitting those.
    """
    if not best.model.coarse:
        return LEFT
    return COARSE if best.model.added == 1 else DETAILS


def _worth(gain: float, enough: float) -> float:
    """How sure it is that a gain is more than chance and the other effect's details make.

    What is enough is thousands where it is a share of much evidence, and no sharper than that share; it is without end
    for what was withdrawn.
    """
    if not np.isfinite(enough):
        return 0.0
    return float(expit((gain - enough) / max(COLDEST, COARSE * enough)))


def judge(
    fitter: Fitter, found: Explanation, in_loop: float | None = None, closes: Sequence[float | None] = ()
) -> Verdict:
    """The verdict on an explanation. `in_loop` is the share of the gap in closed loop that is left, if known; `closes`,
    of each effect, the share of the missing force in what is held out (its mean square beyond the floor) that it surely
    takes away.

    Small errors that last cost much likelihood and little force. So an effect that takes away most of the force is
    believed to `UNSURE` at least.

    Of an effect whose details differ from machine to machine, a filter tells too little and too much: by such details
    it is off also with the right effect, and it may follow with a wrong one whose simulation runs away. Beside one, and
    only there, the simulation of what was held out says how much is explained.
    """
    base, best = found.base, found.best
    effects = best.model.added
    incomplete = not is_complete(fitter, base)
    share = share_left(fitter, base, best) if incomplete else 0.0
    unexplained, gap = share, "the gap"
    if incomplete and best.model.coarse and in_loop is not None:
        unexplained, gap, closes = in_loop, "the gap in closed loop", ()  # a filter's share tells nothing then
    left = unexplained / _may_leave(best)
    known = float(1.0 / (1.0 + left ** (3.0 / np.log(SHARPNESS)))) if incomplete else 1.0
    sure = NEAREST + (1.0 - NEAREST) * known
    much_left = known < 0.5
    taking = [much_left and one is not None and one >= TAKEN for one in closes or [None] * effects]
    surely = [max(sure, UNSURE) if one else sure for one in taking]
    beliefs: list[Belief] = []
    for number, looked in enumerate(found.rounds):
        if not looked.fits:
            continue
        certain = (surely[number] if number < len(surely) else sure) * _worth(looked.gain, looked.enough)
        beliefs += _believed(looked, number, share, number < effects, certain)
    beliefs = _at_most(SUREST, _one_of_each(_shared(beliefs, found, share, sure, surely)))
    beliefs.sort(key=lambda one: (not one.found, one.round if one.found else 0, -one.confidence))
    if not effects:
        return _nothing_found(base, beliefs, incomplete)
    if not known >= 0.5:
        says = _closest(beliefs, taking, f"{100 * unexplained:.0f} % of {gap}")
        return Verdict("unknown", _unsure(beliefs), share, says)
    much = f"{gap}, but for {100 * unexplained:.0f} % of it" if unexplained >= TOLD else gap
    return _found(found, beliefs, incomplete, share, much)


def _closest(beliefs: list[Belief], taking: Sequence[bool], rest: str) -> str:
    """What effects say that leave too much: in likelihood, but some of them not in force."""
    named = [one.effect for one in beliefs if one.found]
    comes, leaves = ("come", "leave") if len(named) > 1 else ("comes", "leaves")
    says = f"{', '.join(named)} {comes} closest, but {leaves} {rest} unexplained"
    most = [one.effect for one in beliefs if one.found and taking[one.round]]
    if not most:
        return says
    take = "take" if len(most) > 1 else "takes"
    says = f"{says}; that is by likelihood, where small errors that last count most: of the missing force"
    return f"{says} {' and '.join(most)} {take} away {100 * TAKEN:.0f} % and more of its mean square"


def _nothing_found(base: Fitted, beliefs: list[Belief], incomplete: bool) -> Verdict:
    """The verdict where no effect was worth it."""
    if incomplete:
        says = "something is missing that no effect of the catalogue explains"
        return Verdict("unknown", _unsure(beliefs), 1.0, says)
    if max_prior_deviation(base) >= STRAINED:
        says = f"{largest_deviation_says(base)}: the drive file is wrong by that much, or it makes up for an effect"
        return Verdict("unknown", _unsure(beliefs), 0.0, says)
    return Verdict("none", beliefs, 0.0, "the recalibrated drive explains the logs to the noise: no effect is missing")


def _beyond_no_gap(found: Explanation, named: str) -> str:
    """What is said of effects where recalibration leaves no gap: why it moved a number far, or what else they bring."""
    if restores_nominal(found.best, found.base):
        return f"recalibration hides the gap: {largest_deviation_says(found.base)}, which {named} makes needless"
    return f"the recalibrated drive explains the logs to the noise, and with {named} they are likelier still"


def _found(found: Explanation, beliefs: list[Belief], incomplete: bool, share: float, much: str) -> Verdict:
    """The verdict on effects that leave only a `share` of the gap, and explain so `much`."""
    named = " and ".join(one.effect for one in beliefs if one.found)
    explains = "explain" if found.best.model.added > 1 else "explains"
    if not incomplete and max_prior_deviation(found.best) > IMPOSSIBLE:
        still = largest_deviation_says(found.best)
        says = f"recalibration hides the gap, and {named} {explains} it no better: still {still}"
        return Verdict("unknown", _unsure(beliefs), 0.0, says)
    others = sorted({name for one in beliefs if one.found for name in one.alternatives} - found.named)
    says = f"{named} {explains} {much}" if incomplete else _beyond_no_gap(found, named)
    says += f"; these logs do not exclude {', '.join(others)}" if others else ""
    return Verdict("effect", beliefs, share, says)
