"""Which effects explain the logs: one after the other, each judged beside free functions.

    the table of a filter that trusts the model -> the likeliest few fitted -> the best, if it is worth it

Nothing is vetoed. An effect is taken if the logs are likelier with it by `NEEDED`, and by as much beside the functions,
so that what it explains is not merely something that depends on place, speed, time or command.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import is_complete, relevant_forces
from tuning.diagnosis.fits.threads import in_parallel
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.setting import Setting
from tuning.diagnosis.selection.refit import possible, refit_rivals, renamed
from tuning.diagnosis.selection.screening import TRIED, begin, joined
from tuning.hypotheses.screws import places, refined
from tuning.hypotheses.table import Entry, entries, grid, table_of

# in -2 log likelihood: one of the catalogue's 23 kinds is as likely as the others (2 log 23 = 6.3), and the odds for it
# are then to be "very strong", 150 to 1 (Kass and Raftery 1995: 10)
NEEDED = 16.0
DETAIL = 0.2  # of what an effect does, by which the form of a coarse one may be off: it leaves the square of that
TRUSTING = 0.1  # of the forces that the filter of a fit may invent: with a tenth, what a model lacks stands out
SHARES = (1.0, TRUSTING)  # the same, in which free functions are held against what was found
NEAR = 0.2  # of the best evidence in the table: an effect that is linearised in a wrong place has less than it is worth
FITTED = 4  # effects that are fitted at most

Say = Callable[[str], None]


class Judged(NamedTuple):
    """A fit, and how likely the logs are with it (-2 log): as it is, and with functions free beside it."""

    fitted: Fitted
    plain: float
    free: float


class Looked(NamedTuple):
    """One more effect looked for beside `before`: the best entry of each, and those that were fitted; best first."""

    before: Judged
    entries: list[Entry]
    fits: list[Fitted]


class Found(NamedTuple):
    """The recalibrated drive, what was looked at for each effect, and the machine in the end."""

    base: Judged
    rounds: list[Looked]
    best: Judged

    @property
    def effects(self) -> list[str]:
        """The names of what was found."""
        members = self.best.fitted.model.members
        return [one.candidate.name for one in members[len(self.base.fitted.model.members) :]]


def search(
    fitter: Fitter, base: Fitted, catalogue: Sequence[Candidate], at: Setting, most: int, say: Say = lambda _: None
) -> Found:
    """Effects one after the other, up to so many, as long as another is worth it."""
    begun = judged(fitter, base, at)
    best, rounds = begun, list[Looked]()
    while len(rounds) < most:
        needed = _needed(begun, best)
        looked = look(fitter, best, best.fitted, catalogue, at, say)
        if rounds and best.fitted.model.coarse and not is_complete(fitter, best.fitted):
            for beside in possible([_as_in_table(fitter, rounds[-1], best.fitted)]):
                looked = min(looked, look(fitter, best, beside, catalogue, at, say), key=_unlikelihood)
        rounds.append(looked)
        if not looked.fits:
            break
        other = judged(fitter, looked.fits[0], at)
        enough = NEEDED if is_complete(fitter, other.fitted) else needed
        if min(best.plain - other.plain, best.free - other.free) < enough:
            break
        best = other
    return Found(begun, rounds, best)


def _unlikelihood(looked: Looked) -> float:
    return looked.fits[0].evidence if looked.fits else np.inf


def _as_in_table(fitter: Fitter, looked: Looked, best: Fitted) -> Fitted:
    """The effect that was taken as it stood beside the functions, and nothing fitted without them.

    A gap that a constant force holds to one side is right there. Fitted alone, it makes up for that force.
    """
    kind = best.model.members[-1].candidate.kind
    entry = next(one for one in looked.entries if one.candidate.kind == kind)
    theta = np.r_[entry.rest, begin(best.model, entry.values)]
    return fitter.fit(best.model, theta, best.process_noise, best.filtered.trajectory, most=0)


def _needed(base: Judged, best: Judged) -> float:
    """The evidence that one more effect must bring, where something is left with it, too."""
    return max(NEEDED, DETAIL**2 * (base.plain - best.plain)) if best.fitted.model.coarse else NEEDED


def trusting(fitter: Fitter, fitted: Fitted, share: float) -> Fitted:
    """The fit in a filter that may invent that share of its forces; not less than what counts as nothing missing."""
    least = np.minimum(relevant_forces(fitter, fitted), fitted.process_noise)
    return fitter.under(fitted, np.maximum(share * fitted.process_noise, least))


def judged(fitter: Fitter, fitted: Fitted, at: Setting) -> Judged:
    """How likely the logs are; with functions, in the filter that suits them best."""
    free = []
    for share in SHARES:
        under = trusting(fitter, fitted, share)
        if np.isfinite(under.evidence):
            free.append(under.cost + under.second_encoder_deviance - table_of(under, at).evidence)
    return Judged(fitted, fitted.evidence, min(free, default=np.inf))


def look(
    fitter: Fitter, before: Judged, start: Fitted, catalogue: Sequence[Candidate], at: Setting, say: Say
) -> Looked:
    """One more effect, beside what `before` has, where `start` has that."""
    there = [member.candidate for member in start.model.members]
    apart = [one for one in catalogue if not any(one.excludes(other) for other in there)]
    under = trusting(fitter, start, TRUSTING)
    table = table_of(under if np.isfinite(under.evidence) else start, at)
    say("screening")
    logs = table.fitted.model.logged.logs

    def screened(candidate: Candidate) -> list[Entry]:
        points = places(candidate, logs) if candidate.searched else grid(table, candidate)
        return entries(fitter, table, candidate, points)

    ordered = sorted(apart, key=lambda one: not one.searched)  # what takes longest first
    found = _first_of_each(one for each in in_parallel(screened, ordered) for one in each)
    say("searching for screws")
    screws = [one for one in _near(found) if one.candidate.searched]
    found = _first_of_each([*in_parallel(lambda one: refined(fitter, table, one), screws), *found])
    say("fitting")
    promising = sorted(_near(found)[:FITTED], key=lambda one: not one.candidate.coupled)
    fits = in_parallel(lambda one: fit_of(fitter, start, one), promising)
    return Looked(before, found, refit_rivals(fitter, fits))


def _near(found: Sequence[Entry]) -> list[Entry]:
    """What may be as good as the best, once it is fitted."""
    best = max((one.evidence for one in found), default=0.0)
    return [one for one in found if one.evidence > max(NEEDED, NEAR * best)]


def _first_of_each(found: Iterable[Entry]) -> list[Entry]:
    """The best entry of each effect, best first; with and without some of its numbers it is two."""
    kinds: dict[tuple[str, ...], Entry] = {}
    for one in sorted(found, key=lambda one: -one.evidence):
        if np.isfinite(one.evidence):
            kinds.setdefault(one.candidate.kind, one)
    return list(kinds.values())


def fit_of(fitter: Fitter, before: Fitted, found: Entry) -> Fitted:
    """From what the table has; what was free before moved along, as it was, or as the drive file has it."""
    model = joined(before.model, found.candidate, found.values)
    own = begin(model, found.values)
    nominal = np.r_[np.zeros(len(NAMES)), before.theta[len(NAMES) :]]
    rests = [found.rest, before.theta] if found.candidate.coupled else [found.rest, before.theta, nominal]
    begun = [fitter.at(model, np.r_[rest, own], before.process_noise, before.filtered.trajectory) for rest in rests]
    begun = [fitter.with_process(one, model, before.process_noise * TRIED) for one in begun]
    there = min(begun, key=lambda one: one.cost)
    return renamed(fitter, fitter.fit(model, there.theta, there.process_noise, there.filtered.trajectory))
