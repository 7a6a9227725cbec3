"""The effect of the catalogue that explains most of what a hypothesis leaves, and its rivals.

    screen the catalogue -> fit the most promising, a few steps -> the best to their end, what is searched for again

The candidates of one round do not depend on one another.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple, TypeVar

import jax.numpy as jnp
import numpy as np

from diffdrive.errors import ParameterError
from diffdrive.model.uncertainty import Uncertainty
from tuning.diagnosis.filter.effect_signals import Trajectory
from tuning.diagnosis.fits.fitted import Fitted, last_candidate
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import comparable_parameters, max_prior_deviation, restores_nominal
from tuning.diagnosis.fits.threads import in_parallel
from tuning.diagnosis.hypotheses.calibration import prior_root
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import Logged, Member, Model
from tuning.diagnosis.levels import DETAILS, IMPOSSIBLE, LEFT, STRAINED, WORTH
from tuning.diagnosis.selection.first_fits import BESIDE, PROMISING, RACE, begun_again, fit_from, fit_to_nominal
from tuning.diagnosis.selection.refit import (
    allowance,
    at_nominal,
    continued,
    possible,
    refit_rivals,
    renamed,
    searched_again,
    simpler,
)
from tuning.diagnosis.selection.screening import Screened, read_screened, screen, tried, written_screened
from tuning.store.store import digest

FITTED = 5  # candidates of a round that are fitted
BACK = 2  # of those fitted that were believed before another was known, beside what is promising now
CLOSE = 0.7  # of the best gain, that an effect must bring to be searched for again
FINISH, STAYS = 3, 0.5  # how many are fitted to the end, and the share of the best gain by then that it takes
SETTLED = WORTH / DETAILS  # in evidence, of one that explains everything: what its details make is worth an effect

Progress = Callable[[str, int, int], None]
A = TypeVar("A")


class Round(NamedTuple):
    """What was found when one more effect was looked for."""

    before: Fitted
    screened: list[Screened]  # best first
    fits: list[Fitted]  # best first
    rivals: int  # how many of these, the first ones, may stand for one another
    allowance: float  # in evidence, that the first may lack since it avoids impossible parameters
    enough: float = WORTH  # in evidence, that the first had to bring

    def with_first(self, fit: Fitted) -> "Round":
        """The same with this fit in the place of the first."""
        return self._replace(fits=[fit, *self.fits[1:]])

    @property
    def gain(self) -> float:
        """Evidence that the first brought, and what it may lack."""
        return self.before.evidence - self.fits[0].evidence + self.allowance

    @property
    def worth_it(self) -> bool:
        """Whether the first brought enough."""
        return bool(self.fits) and self.gain >= self.enough


def initial_trajectory(logged: Logged) -> Trajectory:
    """The trajectory before any filter: where the table was measured, at rest."""
    zero = jnp.zeros_like(logged.lanes.position)
    return Trajectory(logged.lanes.position, zero, zero, zero, zero)


def recalibrated(
    fitter: Fitter, tolerance: float, members: tuple[Member, ...] = (), uncertainty: Uncertainty | None = None
) -> Fitted:
    """The nominal drive with nothing but its parameters adjusted, each within what its prior allows.

    `members` are effects that the nominal drive has, with nothing free; `uncertainty` is what its file doubts. Raises
    `ParameterError` for a drive that no filter can run.
    """
    logged = fitter.logged
    prior = prior_root(logged.drive, tolerance, uncertainty, logged.loop_samples, logged.constant_load)
    model = Model(logged, members, prior)
    found = fitter.fit(model, np.zeros(model.size), None, initial_trajectory(fitter.logged))
    if not np.isfinite(found.evidence):
        raise ParameterError(
            "the drive file's drive cannot be run along these logs: check that mass and friction are of the right "
            "size, and that Coulomb friction plus breakaway gap is above zero in both directions"
        )
    return found


def _screened(fitter: Fitter, before: Fitted, candidate: Candidate) -> Screened | None:
    def found() -> Screened | None:
        if any(one.amplitude for one in candidate.parameters):
            return screen(before, candidate)
        return tried(fitter, before, candidate)

    if fitter.store is None:
        return found()
    at = (before.model, before.theta, before.process_noise, before.filtered, before.signals)
    key = digest("screened", fitter.logged, at, candidate)
    kept = fitter.store.read(key)
    if kept is not None:
        return read_screened(candidate, kept)
    screened = found()
    if screened is not None:
        fitter.store.write(key, written_screened(screened))
    return screened


def select_next_effect(
    fitter: Fitter,
    before: Fitted,
    catalogue: Sequence[Candidate],
    progress: Progress,
    left: Callable[[Fitted], float],
    known: Sequence[Fitted] = (),
) -> Round:
    """One more effect; `left` is the share of the gap that a fit leaves, and `known` are fits of effects that were
    looked for before another was known.

    Where the nominal parameters were moved too far to be believed, it is looked for about the drive file's own numbers
    too. Effects that have to be searched for are, where no other explains it all.
    """
    there = [member.candidate for member in before.model.members]
    apart = [one for one in catalogue if not any(one.excludes(other) for other in there)]
    few, searched = [one for one in apart if not one.searched], [one for one in apart if one.searched]
    screened, fits = _race(fitter, before, few, progress, known, left)
    fits = refit_rivals(fitter, fits)
    believed = None
    if max_prior_deviation(before) > IMPOSSIBLE and not (
        fits and is_sufficient(fits[0], left) and max_prior_deviation(fits[0]) < STRAINED
    ):
        believed = at_nominal(fitter, before)
        more = [] if believed is None else _race_to_nominal(fitter, before, believed, few, progress)
        fits = refit_rivals(fitter, [*fits, *more])
    gains = fits and before.evidence - fits[0].evidence > SETTLED
    if not (gains and is_sufficient(fits[0], left) and max_prior_deviation(fits[0]) < IMPOSSIBLE):
        also, further = _race(fitter, before, searched, progress, known, left)
        further += simpler(fitter, before, further, searched)
        screened, fits = screened + also, refit_rivals(fitter, _again(fitter, before, fits + further, left))
    screened.sort(key=lambda one: -one.evidence)
    return _ranked(before, believed, screened, fits)


def is_sufficient(fitted: Fitted, left: Callable[[Fitted], float]) -> bool:
    """Whether a fit leaves no more than the details of its effects may."""
    return left(fitted) < (DETAILS if fitted.model.coarse else LEFT)


def _again(fitter: Fitter, before: Fitted, fits: Sequence[Fitted], left: Callable[[Fitted], float]) -> Sequence[Fitted]:
    """The fits, those that bring nearly as much as the best and have to be searched for searched for again.

    Not where the best leaves next to nothing: no rival will do better.
    """
    fits = possible(fits)
    if not fits or (max_prior_deviation(fits[0]) < STRAINED and left(fits[0]) < LEFT):
        return fits
    near = CLOSE * (before.evidence - fits[0].evidence)

    def again(one: Fitted) -> Fitted:
        searched = last_candidate(one).searched and before.evidence - one.evidence >= near
        return searched_again(fitter, before, one) if searched else one

    return in_parallel(again, fits)


def _ranked(before: Fitted, believed: Fitted | None, screened: list[Screened], fits: Sequence[Fitted]) -> Round:
    """The fits of a round by evidence; those that bring impossible parameters back go ahead of all that do not, unless
    one that needs no impossible parameters clearly explains more, or the best more than those parameters ever did.
    """
    every = _best_of_each(fits)
    relieving = _best_of_each(_relieving(before, believed, fits))
    if believed is None or not relieving or _clearly(every[0], relieving[0]):
        return Round(before, screened, every, len(every), 0.0)
    if relieving[0].evidence - every[0].evidence > max(believed.cost - before.cost, SETTLED):
        return Round(before, screened, every, len(every), 0.0)
    named = {last_candidate(one).name for one in relieving}
    others = [one for one in every if last_candidate(one).name not in named]
    return Round(before, screened, [*relieving, *others], len(relieving), allowance(before, believed))


def _clearly(best: Fitted, relieving: Fitted) -> bool:
    """Whether the best may stay the best, though another effect leaves the nominal parameters nearer to the file's."""
    return max_prior_deviation(best) < IMPOSSIBLE and relieving.evidence - best.evidence > SETTLED


def _relieving(before: Fitted, believed: Fitted | None, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits, best first, that explain as much as `before` and move no nominal parameter far."""
    if believed is None:
        return []
    most = before.evidence + allowance(before, believed)

    def relieving(one: Fitted) -> bool:
        return (
            max_prior_deviation(before, comparable_parameters(one)) > IMPOSSIBLE and max_prior_deviation(one) < STRAINED
        )

    return sorted((one for one in fits if one.evidence < most and relieving(one)), key=lambda one: one.evidence)


def first_of_each(fits: Iterable[Fitted]) -> list[Fitted]:
    """The first fit of each effect, in their order."""
    found: dict[str, Fitted] = {}
    for one in fits:
        found.setdefault(last_candidate(one).name, one)
    return list(found.values())


def excluding(all_of: Sequence[A], some: Sequence[A]) -> list[A]:
    """All but some."""
    held = {id(one) for one in some}
    return [one for one in all_of if id(one) not in held]


def _race(
    fitter: Fitter,
    before: Fitted,
    catalogue: Sequence[Candidate],
    progress: Progress,
    known: Sequence[Fitted],
    left: Callable[[Fitted], float],
) -> tuple[list[Screened], list[Fitted]]:
    """Screened, best first, and the promising ones fitted, best first: a few steps each, the best to the end.

    Those that would explain not half as much as the best wait for its fit: where that explains everything, none of
    them will do as well.
    """
    found = in_parallel(
        lambda one: _screened(fitter, before, one), catalogue, lambda k: progress("screening", k, len(catalogue))
    )
    screened = sorted((one for one in found if one is not None), key=lambda one: -one.evidence)
    promising = _promising(screened)
    promising += _bringing_back(before, known, excluding(_likeliest(screened), promising))
    alone = {last_candidate(one).kind: one for one in known}

    def fitted(some: Sequence[Screened], done: int) -> list[Fitted]:
        return in_parallel(
            lambda one: fit_from(fitter, before, one, RACE, alone.get(one.candidate.kind)),
            sorted(some, key=lambda one: not one.candidate.coupled),  # what takes longest first
            lambda k: progress("fitting", done + k, 2 * len(promising)),
        )

    near = STAYS * max((one.evidence for one in promising), default=0.0)
    first = [one for one in promising if one.evidence >= near]
    begun = _best_of_each(fitted(first, 0))
    if not (begun and _explains_all(before, begun[0], left)):
        begun = _best_of_each([*begun, *fitted(excluding(promising, first), len(first))])
    begun = _best_of_each([*begun, *begun_again(fitter, before, begun)])
    gains = [before.evidence - one.evidence for one in begun]
    enough = STAYS * max(gains, default=0.0) - PROMISING
    ahead = [one for one, gain in zip(begun, gains, strict=True) if gain > enough][:FINISH]
    return screened, _ended(fitter, begun, ahead, len(promising), progress)


def _explains_all(before: Fitted, fitted: Fitted, left: Callable[[Fitted], float]) -> bool:
    """Whether a fit gains much, leaves next to nothing, and needs no nominal parameter moved far for it."""
    gains = before.evidence - fitted.evidence > SETTLED
    return gains and max_prior_deviation(fitted) < STRAINED and is_sufficient(fitted, left)


def _promising(screened: Sequence[Screened]) -> list[Screened]:
    """What is worth a fit of what was screened, best first.

    So is all that was searched for: screening sees only where it begins.
    """
    return [one for one in _likeliest(screened) if one.candidate.searched or one.evidence > PROMISING][:FITTED]


def _bringing_back(before: Fitted, known: Sequence[Fitted], others: Sequence[Screened]) -> list[Screened]:
    """Those of the others that needed no nominal parameter moved far, before an effect was known that has one moved.

    Best first, as they were then. That parameter may stand in for one of them, and screening sees nothing left for it.
    """
    evidence = {last_candidate(one).name: one.evidence for one in known if restores_nominal(one, before)}
    found = [one for one in others if one.candidate.name in evidence]
    return sorted(found, key=lambda one: evidence[one.candidate.name])[:BACK]


def _likeliest(screened: Sequence[Screened]) -> list[Screened]:
    """Of each kind the first; what is screened is given best first."""
    kinds = {one.candidate.kind: one for one in reversed(screened)}
    return [one for one in screened if one is kinds[one.candidate.kind]]


def _race_to_nominal(
    fitter: Fitter, before: Fitted, believed: Fitted, catalogue: Sequence[Candidate], progress: Progress
) -> list[Fitted]:
    """The promising about the drive file's own numbers fitted: those that bring the parameters back to the end."""
    promising = _about_nominal(believed, catalogue)
    begun = in_parallel(
        lambda one: fit_to_nominal(fitter, before, one),
        promising,
        lambda k: progress("fitting", k, 2 * len(promising)),
    )
    begun = _best_of_each(begun)
    return _ended(fitter, begun, _relieving(before, believed, begun)[:FINISH], len(promising), progress)


def _ended(
    fitter: Fitter, begun: Sequence[Fitted], ahead: Sequence[Fitted], count: int, progress: Progress
) -> list[Fitted]:
    """All that was begun, those `ahead` led to their end."""
    ended = in_parallel(
        lambda one: renamed(fitter, continued(fitter, one)),
        ahead,
        lambda k: progress("fitting", count + k, count + len(ahead)),
    )
    return [*ended, *excluding(begun, ahead)]


def _about_nominal(believed: Fitted, catalogue: Sequence[Candidate]) -> list[Screened]:
    """The promising about the drive file's own numbers: where recalibration went astray, nothing looks as it is."""
    amounts = [one for one in catalogue if any(parameter.amplitude for parameter in one.parameters)]
    found = in_parallel(lambda one: screen(believed, one), amounts)
    found.sort(key=lambda one: -one.evidence)
    found = _likeliest(found)
    few = found[:BESIDE]
    return few + [one for one in excluding(found, few) if one.candidate.absorbable]


def _best_of_each(fits: Iterable[Fitted]) -> list[Fitted]:
    """One fit of each effect, the best first."""
    return first_of_each(possible(fits))
