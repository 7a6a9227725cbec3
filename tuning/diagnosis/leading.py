"""Fits led on to where no more of it gains, along the ways that a fit alone does not find."""

from collections.abc import Iterable, Sequence

import numpy as np

from tuning.diagnosis.calibration import NAMES
from tuning.diagnosis.cooling import cooled
from tuning.diagnosis.evolving import evolved
from tuning.diagnosis.fitting import MOST_STEPS, Fitted, Fitter
from tuning.diagnosis.harmonics import at_its_root
from tuning.diagnosis.leftover import STRAINED, WORTH, strain
from tuning.diagnosis.model import Model
from tuning.diagnosis.screening import begin

LONGER = 4  # times the most steps, for the best
SEARCHES, IDLE = 3, 2  # more at most around a fit of what has to be searched for, and in a row that may gain nothing


def possible(fits: Iterable[Fitted]) -> list[Fitted]:
    """Those of a machine that can be, best first."""
    kept = [one for one in fits if np.isfinite(one.evidence) and one.model.possible(one.u)]
    return sorted(kept, key=lambda one: one.evidence)


def on(fitter: Fitter, one: Fitted) -> Fitted:
    """The fit gone on with, from where it ended; itself where that leads to no machine that can be."""
    further = fitter.fit(one.model, one.u, one.process, one.track.course)
    return next(iter(possible([further])), one)


def renamed(fitter: Fitter, one: Fitted) -> Fitted:
    """The fit with the wave that was added last told by its own period, where that is no worse."""
    last = one.model.members[-1]
    values = one.model.values(one.u)[-1]
    rooted = at_its_root(last.candidate, values)
    if rooted is values:
        return one
    own = begin(one.model, rooted)
    again = fitter.fit(one.model, np.r_[one.u[: one.u.size - own.size], own], one.process, one.track.course)
    return again if again.cost < one.cost + WORTH else one


def to_its_end(fitter: Fitter, one: Fitted) -> Fitted:
    """A fit, however few steps it was given, where no more of them gain."""
    for _ in range(1 + LONGER):
        further = on(fitter, one)
        if further is one or further.steps < MOST_STEPS:
            return further
        one = further
    return one


def _searched(model: Model) -> int | None:
    """Which member has to be searched for; None where there is none."""
    members = enumerate(model.members)
    return next((k for k, one in members if one.candidate.searched and one.candidate.parameters), None)


def searched_again(fitter: Fitter, before: Fitted, one: Fitted) -> Fitted:
    """The fit, what of it has to be searched for searched again where the fit has all else, if that ends better.

    At first all else was as the drive file has it, or as it was without that effect: a wrong gap times the blows then.
    """
    index = _searched(one.model)
    if index is None:
        return one
    its = one.model.of_member(index)
    found, idle = [one, likelier(one, cooled(fitter, one.model, one.u, one.track.course))], 0
    for seed in range(1, 1 + SEARCHES):
        idle = 0 if found[-2].evidence - found[-1].evidence > WORTH else idle + 1
        if idle == IDLE:
            break
        u = found[-1].u.copy()
        values, _ = evolved(before, one.model, index, u, seed)
        u[its] = begin(one.model, values, index)
        found.append(likelier(found[-1], cooled(fitter, one.model, u, found[-1].track.course)))
    return found[-1]


def likelier(one: Fitted, other: Fitted) -> Fitted:
    """The other where it is a machine that can be, and the likelier one."""
    return min(possible([one, other]), key=lambda fit: fit.evidence, default=one)


def begun_anew(fitter: Fitter, one: Fitted) -> Fitted:
    """A coupled fit that moved nominal parameters far, begun again from the drive file's, if that ends better.

    Its Jacobian is carried from step to step, which ends early in a long valley.
    """
    if not one.model.coupled or strain(one) < STRAINED:
        return one
    u = np.r_[np.zeros(len(NAMES)), one.u[len(NAMES) :]]
    if _searched(one.model) is not None:
        return likelier(one, cooled(fitter, one.model, u, one.track.course))
    return likelier(one, to_its_end(fitter, fitter.fit(one.model, u, one.process, one.track.course)))


def led_on(fitter: Fitter, fits: Sequence[Fitted]) -> list[Fitted]:
    """The fits that can be, best first, the best at its end: what it has not yet explained, others would seem to."""
    fits = possible(fits)
    for _ in range(LONGER):
        if not fits or fits[0].steps < MOST_STEPS:
            break
        further = on(fitter, fits[0])
        if further is fits[0]:
            break
        fits = possible([further, *fits[1:]])
    return fits
