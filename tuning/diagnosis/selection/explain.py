"""Which effects explain the logs: recalibrated, with one effect, with two, and so on as long as another is worth it."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tuning.diagnosis.fits.curvature import limited, solved
from tuning.diagnosis.fits.fitted import Fitted, last_candidate
from tuning.diagnosis.fits.fitting import NEAR, Fitter
from tuning.diagnosis.fits.goodness_of_fit import (
    is_complete,
    is_implausible,
    is_lost_throughout,
    max_prior_deviation,
    restores_nominal,
    share_left,
    sudden_force_evidence,
)
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import Logged, Vector
from tuning.diagnosis.levels import COARSE, DETAILS, IMPOSSIBLE, LACKING, STRAINED, WORTH
from tuning.diagnosis.selection.explanation import Explanation, is_better, last_outweighs_the_rest, other_first
from tuning.diagnosis.selection.refit import drop_effect, refit_from_nominal, searched_again, to_its_end
from tuning.diagnosis.selection.search import (
    Progress,
    Round,
    excluding,
    first_of_each,
    is_sufficient,
    select_next_effect,
)
from tuning.diagnosis.selection.stages import Tell, of_round, unheard

MOST_EFFECTS = 2


def _refit_without_last(fitter: Fitter, before: Fitted, fits: Sequence[Fitted]) -> Fitted | None:
    """`before` fitted again from the best fit with one effect more, where it improves without that effect.

    A fit that stopped on its way leaves its gain to any effect that sets it going again.
    """
    if not fits:
        return None
    best = fits[0]
    processes = np.vstack([best.process_noise * NEAR, before.process_noise * NEAR])
    # the first for the filter's process force alone, which may be another
    ends = [before.theta, *_without(before, best)]
    begun = [fitter.at(before.model, theta, best.process_noise, best.filtered.trajectory) for theta in ends]
    there = min((fitter.with_process(one, before.model, processes) for one in begun), key=lambda one: one.cost)
    if before.cost - there.cost < WORTH:
        return None
    further = fitter.refit(there, before.model)
    return further if further.evidence < before.evidence and further.model.possible(further.theta) else None


def _without(before: Fitted, best: Fitted) -> list[Vector]:
    """Where `before` may begin: its parameters in the fit with one effect more, as they are and corrected for its
    removal.
    """
    count = before.theta.size
    found, own = best.theta[:count], best.jacobian[:, :count]
    known = last_candidate(best).by_name
    amounts = np.array([known[name].amplitude for _, name, _ in best.model.slots[count - len(NAMES) :]])
    if not amounts.any():
        return [found]
    taken = best.residual - best.jacobian[:, count:] @ (amounts * best.theta[count:])
    step = -solved(own.T @ own + np.eye(count), own.T @ taken + found)
    return [found, found + limited(step)]


def evidence_needed(fitter: Fitter, base: Fitted, best: Fitted, ended: bool, fits: Sequence[Fitted]) -> float:
    """The evidence that one more effect must bring beside the `best`, which explains all where it is `ended`.

    Less than a share of what was explained before may be a detail of that: of what effects explain and, of snapshots,
    of what the sudden force between them does. That force is as coarse a model as any effect whose details differ.
    """
    if fits and restores_nominal(fits[0], best):
        return WORTH
    model, gained = best.model, base.evidence - best.evidence
    sudden = COARSE * sudden_force_evidence(fitter, best)
    if ended and not model.coarse:
        return max(LACKING, sudden)
    slight = COARSE if model.coarse or is_lost_throughout(fitter, base) else DETAILS
    enough = max(LACKING if ended else WORTH, slight * gained)
    if fits and not model.coarse and is_complete(fitter, fits[0]):
        enough = min(enough, LACKING)
    return max(enough, sudden)


def is_looked_for(one: Candidate, logged: Logged, by_second_encoder: bool, moved: bool) -> bool:
    """Whether an effect is looked for where no force is missing; `moved` is whether a nominal parameter was moved far.

    Only what leaves no missing force. Where the commands between snapshots come from the law of the loop, effects like
    a moved parameter are looked for only once one has moved: an error of that law looks the same.
    """
    if one.twists and by_second_encoder:
        return True
    if one.absorbable and not moved and float(logged.command_std) > 0.0:
        return False
    return one.unseen


@dataclass(frozen=True)
class _Search:
    """The search for effects in logs: one after the other, until another is not worth it or there are `most`."""

    fitter: Fitter
    progress: Progress
    most: int
    tell: Tell = unheard

    def is_explained(self, base: Fitted, one: Fitted) -> bool:
        """Whether nothing is missing any more but details."""
        return (
            is_sufficient(one, partial(share_left, self.fitter, base))
            if one.model.coarse
            else is_complete(self.fitter, one)
        )

    def is_settled(self, base: Fitted, one: Fitted) -> bool:
        """Whether there is nothing left to explain, neither a force nor a number moved far."""
        return self.is_explained(base, one) and max_prior_deviation(one) < STRAINED

    def hides_in_sudden_force(self, base: Fitted, one: Fitted) -> bool:
        """Whether nothing is missing between snapshots, where the sudden force may stand for the effects that were
        fitted: they are compared with it as they are, since no search would follow.
        """
        return one.model.logged.of_snapshots and self.is_explained(base, one)

    def state(self, base: Fitted, one: Fitted) -> tuple[bool, ...]:
        """What decides how the search goes on."""
        return self.is_explained(base, one), max_prior_deviation(one) >= STRAINED, max_prior_deviation(one) > IMPOSSIBLE

    def next_round(
        self, base: Fitted, before: Fitted, catalogue: Sequence[Candidate], rounds: Sequence[Round]
    ) -> Round:
        """One more effect looked for; where nothing is missing any more, not all are (`is_looked_for`)."""
        done, logged = self.is_settled(base, before), before.model.logged
        if rounds and done:
            catalogue = [one for one in catalogue if one.noisy]
        elif self.is_explained(base, before):
            seen = self.fitter.twist is not None
            catalogue = [one for one in catalogue if is_looked_for(one, logged, seen, not done)]
        known = [one for one in rounds[0].fits if rounds[0].before.evidence - one.evidence > WORTH] if rounds else ()
        found = select_next_effect(
            self.fitter, before, catalogue, self.progress, partial(share_left, self.fitter, base), known
        )
        self.tell(of_round(self.with_evidence_needed(base, found)))
        return found

    def needs_no_other(self, base: Fitted, best: Fitted) -> bool:
        """Whether nothing at all is looked for beside what was found. An error of the scale is, but not beside what is
        stepped within the filter, where it costs much.
        """
        return self.is_settled(base, best) and best.model.coupled

    def forward_selection(
        self, base: Fitted, rounds: list[Round], best: Fitted, catalogue: Sequence[Candidate]
    ) -> Explanation:
        """What was found before and, of this catalogue, what is found beside it."""
        while len(rounds) < self.most and not (rounds and self.needs_no_other(base, best)):
            found = self.next_round(base, best, catalogue, rounds)
            further = _refit_without_last(self.fitter, best, found.fits)
            if further is not None:
                from_there = base if rounds else further
                gained, explained = best.evidence - further.evidence, best.evidence - found.fits[0].evidence
                again = gained > COARSE * explained or self.state(base, best) != self.state(from_there, further)
                again = again and not self.hides_in_sudden_force(from_there, further)
                base, best = from_there, further
                if rounds:
                    rounds = [*rounds[:-1], rounds[-1].with_first(best)]
                    if self.needs_no_other(base, best):
                        break
                found = self.next_round(base, best, catalogue, rounds) if again else found._replace(before=best)
            found = self.with_evidence_needed(base, found)
            rounds = [*rounds, found]
            if not found.worth_it:
                break
            best = found.fits[0]
        return Explanation(base, rounds, best)

    def with_evidence_needed(self, base: Fitted, looked: Round) -> Round:
        """The round with the evidence that its first effect has to bring."""
        ended = self.is_explained(base, looked.before)
        return looked._replace(enough=evidence_needed(self.fitter, base, looked.before, ended, looked.fits))

    def refined(self, found: Explanation, catalogue: Sequence[Candidate]) -> Explanation:
        """The end of a search after its early global searches were repeated, impossible parameters replaced and
        needless effects dropped, from where the search goes on; once, not again for what is found then.
        """
        if not is_complete(self.fitter, found.best):
            found = self.searched_again_beside_last(found, catalogue)
        other = self.backward_elimination(_credibly(self.fitter, found))
        if other is found:
            return found
        return self.forward_selection(other.base, other.rounds[: other.best.model.added], other.best, catalogue)

    def backward_elimination(self, found: Explanation) -> Explanation:
        """Without an effect that the others can do without; the same object where there is none.

        An early effect may only resemble the right one, or have freed a fit that was stuck. A last effect may have
        freed the fit before it, and then seems to explain more than all others.
        """
        count = found.best.model.added
        several = range(count if last_outweighs_the_rest(found) else count - 1) if count > 1 else ()
        for index in several:
            fewer = drop_effect(self.fitter, found.best, index)
            if fewer is None:
                continue
            if index == count - 1:
                return self.against_the_rest(found, fewer)
            if fewer.evidence - found.best.evidence >= self.evidence_to_stay(found.base, fewer, found.best):
                continue
            rounds = self.rounds_without(found, index, fewer)
            if rounds is not None:
                return found._replace(rounds=rounds, best=fewer)
        return found

    def against_the_rest(self, found: Explanation, fewer: Fitted) -> Explanation:
        """The last effect judged against the others fitted again without it (`fewer`), and dropped where it brings too
        little then; the same object where that fit gains nothing.
        """
        *before, last = found.accepted
        if fewer.evidence >= last.before.evidence:
            return found
        before[-1] = before[-1].with_first(fewer)
        last = self.with_evidence_needed(found.base, last._replace(before=fewer))
        if is_implausible(fewer, found.best):
            last = last._replace(enough=WORTH)
        if last.worth_it:
            return found._replace(rounds=[*before, last])
        return found._replace(rounds=before, best=fewer)

    def rounds_without(self, found: Explanation, index: int, fewer: Fitted) -> list[Round] | None:
        """The rounds without round `index`, `fewer` being the final fit; None where a later effect alone is no machine
        that can be. Rivals of the dropped round join the next.
        """
        count, rounds, dropped = found.best.model.added, found.rounds[:index], found.rounds[index]
        before, aside, beside = dropped.before, dropped.fits, dropped.fits[: dropped.rivals]
        for number, looked in enumerate(found.rounds[index + 1 : count], index + 1):
            one = fewer if number == count - 1 else drop_effect(self.fitter, looked.fits[0], index)
            if one is None:
                return None
            others = [drop_effect(self.fitter, rival, index) for rival in looked.fits[1 : looked.rivals]]
            rivals = sorted(
                [other for other in [*others, *beside] if other and not is_implausible(other, one)],
                key=lambda other: other.evidence,
            )
            head = first_of_each([one, *rivals])
            fits = first_of_each([*head, *aside])
            joined = Round(before, looked.screened, fits, len(head), looked.allowance)
            rounds = [*rounds, self.with_evidence_needed(found.base, joined)]
            before, aside, beside = one, [], []
        return rounds

    def evidence_to_stay(self, base: Fitted, fewer: Fitted, best: Fitted) -> float:
        """The evidence that an effect must bring beside those that were found after it."""
        if restores_nominal(best, fewer) or is_implausible(fewer, best):
            return WORTH
        enough = max(WORTH, DETAILS * (base.evidence - fewer.evidence))
        enough = min(enough, LACKING) if is_complete(self.fitter, best) else enough
        return max(enough, COARSE * sudden_force_evidence(self.fitter, fewer))

    def searched_again_beside_last(self, found: Explanation, catalogue: Sequence[Candidate]) -> Explanation:
        """The global search for earlier effects repeated beside the last one. Where they explain as much alone by then,
        that one is dropped and the search goes on.
        """
        again = _searched_beside(self.fitter, found)
        if again is found:
            return found
        last = self.with_evidence_needed(found.base, again.rounds[-1])
        if last.worth_it:
            return again._replace(rounds=[*again.rounds[:-1], last])
        return self.forward_selection(found.base, again.rounds[:-1], last.before, catalogue)


def explain(
    fitter: Fitter,
    base: Fitted,
    catalogue: Sequence[Candidate],
    progress: Progress,
    most: int = MOST_EFFECTS,
    tell: Tell = unheard,
) -> Explanation:
    """Effects one after the other, as long as another is worth it, up to `most`; each search is told.

    Where nothing is missing any more, an effect can only say why a nominal parameter was moved so far, what a second
    encoder saw, what passes for noise of the scale or, of snapshots, for the sudden force between them. What is found
    is led to its best. Where something is missing then, the search goes a second way, a rival of the first effect in
    front, beside which only what was found is looked for. Where that ends better, everything is; the other end is kept
    as a rival.
    """
    search = _Search(fitter, progress, most, tell)
    found = search.refined(search.forward_selection(base, [], base, catalogue), catalogue)
    first = other_first(found)
    if first is None or search.is_explained(found.base, found.best):
        return found
    enough = max(first.enough, COARSE * sudden_force_evidence(fitter, first.before))
    first = first._replace(fits=[to_its_end(fitter, first.fits[0]), *first.fits[1:]], enough=enough)

    def beside(catalogue: Sequence[Candidate]) -> Explanation:
        return search.refined(search.forward_selection(found.base, [first], first.fits[0], catalogue), catalogue)

    other = beside([one for one in catalogue if one.name in found.named])
    if not is_better(found.base, other.best, found.best):
        return found._replace(other=other)
    widely = beside(catalogue)
    return (other if is_better(found.base, other.best, widely.best) else widely)._replace(other=found)


def _searched_beside(fitter: Fitter, found: Explanation) -> Explanation:
    """The global search for earlier effects repeated beside the last one, and the fit before that one begun from there:
    else the last effect would have the credit. The same object where that leads nowhere.
    """
    best, last = found.best, found.best.model.added - 1
    if last < 1 or last_candidate(best).searched:
        return found
    best = searched_again(fitter, found.base, best)
    if best is found.best:
        return found
    one = found.rounds[last]
    before = _refit_without_last(fitter, one.before, [best]) or one.before
    rounds = found.rounds[: last + 1]
    rounds[last] = one._replace(before=before, fits=[best, *one.fits[1:]])
    rounds[last - 1] = rounds[last - 1].with_first(before)
    return found._replace(rounds=rounds, best=best)


def _credibly(fitter: Fitter, found: Explanation) -> Explanation:
    """What was found, fitted again without impossible nominal parameters; the same object where that does not succeed.

    Its round is ranked anew: rivals that need such parameters are no rivals, and the evidence that these had added is
    an allowance.
    """
    if not found.best.model.added or max_prior_deviation(found.best) <= IMPOSSIBLE:
        return found
    best, last = refit_from_nominal(fitter, found.base, found.best), found.best.model.added - 1
    if best is found.best:
        return found
    looked = found.rounds[last]
    rivals = [one for one in looked.fits[1 : looked.rivals] if not is_implausible(one, best)]
    credible = sorted([best, *rivals], key=lambda one: one.evidence)
    lost = max(credible[0].evidence - found.best.evidence, 0.0)
    rounds = [*found.rounds]
    rounds[last] = looked._replace(
        fits=[*credible, *excluding(looked.fits[1:], rivals)],
        rivals=len(credible),
        allowance=looked.allowance + lost,
    )
    return found._replace(rounds=rounds, best=credible[0])
