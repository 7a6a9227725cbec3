"""Fits of an effect from where screening points, and from the drive file's own numbers."""

from collections.abc import Sequence

import numpy as np

from tuning.diagnosis.fits.fitted import Fitted, Point
from tuning.diagnosis.fits.fitting import MOST_STEPS, Fitter
from tuning.diagnosis.fits.goodness_of_fit import max_prior_deviation
from tuning.diagnosis.fits.threads import in_parallel
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.model import Model, Vector
from tuning.diagnosis.levels import STRAINED
from tuning.diagnosis.selection.refit import possible
from tuning.diagnosis.selection.screening import Screened, begin, joined

RACE = 4  # first steps of a fit
ALONE = 4  # first steps of a coupled effect
BESIDE = 2  # candidates fitted about the drive file's own numbers, beside those that can bring its parameters back
PROMISING = 4.0  # in evidence


def fit_from(
    fitter: Fitter, before: Fitted, found: Screened, most: int = MOST_STEPS, alone: Fitted | None = None
) -> Fitted:
    """The best of several starts: earlier parameters as screening moves them, moved by the effect's step alone (beside
    a coupled one), unmoved, and nominal; and where the effect was fitted `alone`, before another was known. If that
    start is worse than `before`, from zero amplitude too.

    A coupled effect is no small change: it is fitted alone first, everything else held, which costs little.
    """
    aside = [found.aside] if before.model.coupled else []
    nominal = np.r_[np.zeros(len(NAMES)), before.theta[len(NAMES) :]]
    begun = [_begun(fitter, before, found, rest) for rest in _different(found.rest, *aside, before.theta, nominal)]
    if alone is not None:
        values = alone.model.values(alone.theta)[-1]
        rest = np.r_[alone.theta[: len(NAMES)], before.theta[len(NAMES) :]]
        found_alone = found._replace(values=values, processes=np.vstack([found.processes, alone.process_noise]))
        begun += [_begun(fitter, before, found_alone, rest) for rest in _different(rest, before.theta)]
    model, there = min(begun, key=lambda one: one[1].cost)
    ended = fitter.refit(there, model, most)
    amplitudes = {one.name for one in found.candidate.parameters if one.amplitude}
    if there.cost <= before.cost or not amplitudes:
        return ended
    none = {name: 0.0 * value if name in amplitudes else value for name, value in found.values.items()}
    model = joined(before.model, found.candidate, found.values)
    theta = np.r_[before.theta, begin(model, none)]
    other = fitter.fit(model, theta, before.process_noise, before.filtered.trajectory, most)
    lost = min(ended.evidence, other.evidence) > before.evidence - PROMISING  # neither way has led anywhere yet
    if lost and ended.steps == most and not found.candidate.coupled:
        ended = fitter.refit(ended, ended.model, 2 * most)  # it came from far
    return min(possible([ended, other]) or [ended, other], key=lambda one: one.evidence)


def _different(*points: Vector) -> list[Vector]:
    return list({tuple(one): one for one in points}.values())


def _begun(fitter: Fitter, before: Fitted, found: Screened, rest: Vector) -> tuple[Model, Point]:
    """Where a fit of what was found begins with all else at `rest`."""
    model = joined(before.model, found.candidate, found.values)
    own = begin(model, found.values)
    there = fitter.at(model, np.r_[rest, own], before.process_noise, before.filtered.trajectory)
    there = fitter.with_process(there, model, found.processes)
    if found.candidate.coupled:
        alone = np.r_[np.zeros(before.theta.size), np.ones(own.size)]
        there = fitter.minimise(model, there.theta, there.process_noise, there.filtered.trajectory, ALONE, alone)[0]
    return model, there


def begun_again(fitter: Fitter, before: Fitted, fits: Sequence[Fitted]) -> list[Fitted]:
    """The best fits that need nominal parameters moved far, begun again from the drive file's own, what was added
    last fitted to those first; a few steps each.
    """
    return in_parallel(
        lambda one: _to_nominal_first(fitter, before, one.model, one.theta[before.theta.size :]),
        [one for one in fits[:BESIDE] if max_prior_deviation(one) >= STRAINED],
    )


def fit_to_nominal(fitter: Fitter, before: Fitted, found: Screened) -> Fitted:
    """The effect alone first, the drive file taken at its word; then everything, a few steps.

    A nominal parameter that was moved far lies at the end of a long valley, along which a fit hardly moves.
    """
    model = joined(before.model, found.candidate, found.values)
    return _to_nominal_first(fitter, before, model, begin(model, found.values))


def _to_nominal_first(fitter: Fitter, before: Fitted, model: Model, own: Vector) -> Fitted:
    theta = np.r_[np.zeros(len(NAMES)), before.theta[len(NAMES) :], own]
    alone = np.r_[np.zeros(before.theta.size), np.ones(own.size)]
    first = fitter.minimise(model, theta, None, before.filtered.trajectory, 2 * ALONE, alone)[0]
    return fitter.refit(first, model, RACE)
