"""Fits led on to where no more of it gains, along the ways that a fit alone does not find."""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from tuning.diagnosis.fits.fitted import Fitted, Point, last_candidate
from tuning.diagnosis.fits.fitting import MOST_STEPS, NEAR, Fitter
from tuning.diagnosis.fits.goodness_of_fit import is_complete, is_implausible
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.harmonics import at_its_root
from tuning.diagnosis.hypotheses.model import Model, Vector
from tuning.diagnosis.levels import DETAILS, WORTH
from tuning.diagnosis.selection.evolving import evolved_once
from tuning.diagnosis.selection.screening import begin, joined

LONGER = 4  # times the most steps, for the best
OWN = 8  # steps that an effect is given to fit the drive file's own numbers
SEARCHES = 3  # more at most around a fit of what has to be searched for
RETURNS = 3  # at most to the drive file's own numbers


def possible(fits: Iterable[Fitted]) -> list[Fitted]:
    """Those of a machine that can be, best first."""
    kept = [one for one in fits if np.isfinite(one.evidence) and one.model.possible(one.theta)]
    return sorted(kept, key=lambda one: one.evidence)


def continued(fitter: Fitter, one: Fitted) -> Fitted:
    """The fit gone on with, from where it ended; itself where that leads to no machine that can be."""
    further = fitter.refit(one, one.model)
    return next(iter(possible([further])), one)


def renamed(fitter: Fitter, one: Fitted) -> Fitted:
    """The fit with the wave that was added last told by its own period, where that is no worse."""
    last = one.model.members[-1]
    values = one.model.values(one.theta)[-1]
    rooted = at_its_root(last.candidate, values)
    if rooted is values:
        return one
    own = begin(one.model, rooted)
    again = fitter.fit(
        one.model, np.r_[one.theta[: one.theta.size - own.size], own], one.process_noise, one.filtered.trajectory
    )
    return again if again.cost < one.cost + WORTH else one


def to_its_end(fitter: Fitter, one: Fitted) -> Fitted:
    """A fit, however few steps it was given, where no more of them gain."""
    for _ in range(1 + LONGER):
        further = continued(fitter, one)
        if further is one or further.steps < MOST_STEPS:
            return further
        one = further
    return one


def simpler(fitter: Fitter, before: Fitted, fits: Iterable[Fitted], kinds: Iterable[Candidate]) -> list[Fitted]:
    """Fits of those kinds that the best fit's last effect is but a richer form of, from where that ended: without its
    play, a loose screw is an elastic one. The simpler may have been searched for in a wrong place.
    """
    best = next(iter(possible(fits)), None)
    if best is None:
        return []
    last, values = last_candidate(best), best.model.values(best.theta)[-1]
    found = []
    for kind in kinds:
        if {one.name for one in kind.parameters} < {one.name for one in last.parameters}:
            known = {one.name: values[one.name] for one in kind.parameters}
            model = joined(before.model, kind, known)
            theta = np.r_[best.theta[: before.theta.size], begin(model, known)]
            found.append(fitter.fit(model, theta, best.process_noise, best.filtered.trajectory))
    return found


def drop_effect(fitter: Fitter, one: Fitted, index: int) -> Fitted | None:
    """The fit without one of the effects that were added, from where it ended; None where that is no machine."""
    member = len(one.model.members) - one.model.added + index
    members = (*one.model.members[:member], *one.model.members[member + 1 :])
    model = dataclasses.replace(one.model, members=members)
    fewer = fitter.fit(model, one.theta[~one.model.of_member(member)], one.process_noise, one.filtered.trajectory)
    return next(iter(possible([to_its_end(fitter, fewer)])), None)


def at_nominal(fitter: Fitter, one: Fitted) -> Fitted | None:
    """The same hypothesis with the nominal parameters as the drive file has them; None where no filter can run it."""
    found = fitter.fit(one.model, _nominal(one), None, one.filtered.trajectory, most=0)
    return found if np.isfinite(found.evidence) else None


def allowance(one: Fitted, nominal: Fitted | Point) -> float:
    """What a fit within the drive file's tolerances may lack against one far beyond them."""
    return DETAILS * max(nominal.cost - one.cost, 0.0)


def refit_from_nominal(fitter: Fitter, base: Fitted, one: Fitted) -> Fitted:
    """The fit begun again from the drive file's own numbers, what of it has to be searched for from there.

    The valley to far-off parameters may exist only beside the effects as they were found first; a backlash that is a
    little off is made up for by friction, and is found a little closer each time. The end is taken if it needs no
    impossible parameters and lacks at most `DETAILS` of what these explained: the difference in cost to the same
    effects fitted to the drive file's own numbers.
    """
    nominal = _begun(fitter, one)
    if nominal is None:
        return one
    effects = np.r_[np.zeros(len(NAMES)), np.ones(one.theta.size - len(NAMES))]
    with_nominal = fitter.minimise(
        one.model, nominal.theta, nominal.process_noise, nominal.filtered.trajectory, OWN, effects
    )[0]
    most = one.evidence + allowance(one, with_nominal)
    last = np.inf
    for _ in range(RETURNS):
        ended = to_its_end(fitter, fitter.refit(nominal, one.model))
        ends = possible([ended, searched_again(fitter, base, ended)])  # the other may lead off once more
        taken = next((end for end in ends if end.evidence <= most and is_implausible(one, end)), None)
        if taken is not None:
            return taken
        if not ends or last - ends[0].evidence < WORTH:
            break
        last, nominal = ends[0].evidence, _begun(fitter, ends[0])
        if nominal is None:
            break
    return one


def _nominal(one: Fitted) -> Vector:
    """The values of a fit with the drive file's own nominal parameters."""
    return np.r_[np.zeros(len(NAMES)), one.theta[len(NAMES) :]]


def _begun(fitter: Fitter, one: Fitted) -> Point | None:
    """Where a fit with the drive file's own nominal parameters begins; None where no filter can run it."""
    found = fitter.minimise(one.model, _nominal(one), None, one.filtered.trajectory, 0)[0]
    return found if np.isfinite(found.cost) else None


def _searched(model: Model) -> int | None:
    """Which member has to be searched for; None where there is none."""
    members = enumerate(model.members)
    return next((k for k, one in members if one.candidate.searched and one.candidate.parameters), None)


def searched_again(fitter: Fitter, before: Fitted, one: Fitted) -> Fitted:
    """The fit, what of it has to be searched for searched again where the fit has all else, as long as that gains.

    The first search had all else nominal, or fitted without the effect: a wrong backlash width then mistimes the
    impacts.
    """
    index = _searched(one.model)
    if index is None:
        return one
    its = one.model.of_member(index)
    for seed in range(1, 1 + SEARCHES):
        theta = one.theta.copy()
        found = evolved_once(fitter.store, before, one.model, index, theta, seed)
        if found is None:
            return one
        theta[its] = begin(one.model, found.values, index)
        there = fitter.with_process(
            fitter.at(one.model, theta, one.process_noise, one.filtered.trajectory),
            one.model,
            np.vstack([one.process_noise * NEAR, found.processes * NEAR]),
        )
        other = likelier(one, fitter.refit(there, one.model))
        if one.evidence - other.evidence < WORTH:
            return other
        one = other
    return one


def likelier(one: Fitted, other: Fitted) -> Fitted:
    """The other where it is a machine that can be, and the likelier one."""
    return next(iter(possible([one, other])), one)


def refit_rivals(fitter: Fitter, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits that can be, best first, the best at its end: what it has not yet explained, others would seem to."""
    fits = possible(fits)
    for _ in range(LONGER):
        if not fits or fits[0].steps < MOST_STEPS:
            break
        further = continued(fitter, fits[0])
        if further is fits[0]:
            break
        fits = possible([further, *fits[1:]])
    if not fits or fits[0].model.coupled or is_complete(fitter, fits[0]):
        return fits
    other = refit_without_process_force(fitter, fits[0])
    return possible([to_its_end(fitter, other), *fits]) if likelier(fits[0], other) is other else fits


def refit_without_process_force(fitter: Fitter, one: Fitted) -> Fitted:
    """The fit begun again where the filter may invent hardly any force.

    Parameters and process noise are fitted in turn, each to the other as it is, and such a search has more than one
    end. From a large process noise, which blames the filter for what the parameters should tell, it may miss the end at
    which the model tells all; from the least one it does not, where there is one.
    """
    trajectory = one.filtered.trajectory
    there = fitter.with_process(
        fitter.at(one.model, one.theta, fitter.floor, trajectory), one.model, fitter.quiet(fitter.floor)
    )
    return fitter.refit(there, one.model)
