"""What a fit leaves unexplained, and how far it had to move the drive file's numbers."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diffdrive.effects.friction import PreslidingHysteresis
from diffdrive.model.friction import coulomb
from tuning.diagnosis.filter.ekf import DISTURBANCE_TIME
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.fits.fitting import MOST, Fitter
from tuning.diagnosis.fits.reference_noise import least_trusted, lost_samples, lost_share
from tuning.diagnosis.hypotheses.calibration import DELAY, FORCE, NAMES
from tuning.diagnosis.levels import BLOWS, IMPOSSIBLE, LACKING, STRAINED

MOSTLY = 0.5  # of what is missing
BLIND = 0.05  # of the samples: where the filter is lost at more of them, its cost counts nothing but blows
FEW_LOST = 3  # samples, at which a filter may be lost without anything missing
RELEVANT = 3e-4  # of the friction
UNTOLD = 14  # sudden forces that are tried where no row tells of them
# what a table that slides tells: effects before sliding take over what the others mean
_SLIDING = ("mass", "coulomb_screw", "load_coefficient", "viscous")
SLIDING = tuple(name for name in NAMES if name.split(".")[0] in _SLIDING)


def relevant_forces(fitter: Fitter, fitted: Fitted) -> Float[np.ndarray, " 2"]:
    """Process noise (N) with which nothing counts as missing: a lasting force, with what is unknown of the command, and
    a sudden one of equal effect over its time.
    """
    lasting = float(np.hypot(_relevant(fitted), float(fitter.logged.command_std)))
    return np.array([lasting, _sudden(fitter, lasting)])


def _relevant(fitted: Fitted) -> float:
    """The lasting force (N) below any model's accuracy."""
    return RELEVANT * float(coulomb(fitted.recalibrated_drive.friction, 1.0, 0.0))


def _sudden(fitter: Fitter, lasting: float) -> float:
    """The sudden force (N) of one value per sample that comes to as much as a lasting one over as long."""
    return lasting * float(np.sqrt(max(DISTURBANCE_TIME * fitter.logged.sampling.rate, 1.0)))


def missing_evidence(fitter: Fitter, fitted: Fitted) -> float:
    """By how much a fit is likelier for letting the filter invent a force: nothing much where none is missing.

    A force of `RELEVANT` of the friction is allowed, and a sudden one that comes to as much over as long: the
    simulator's own steps make as much. Between snapshots of a command any sudden force is allowed: no row tells of the
    commands between. The effects are stepped along the same course in both: where one remembers when the table stood
    still, that makes a difference of its own.
    """
    allowed = relevant_forces(fitter, fitted)
    least = np.minimum(fitted.process_noise, allowed)
    if fitter.logged.of_snapshots:
        there = fitter.again(fitted)
        sudden = np.append(np.geomspace(fitter.least, MOST, UNTOLD), fitted.process_noise[1])
        any_sudden = np.stack([np.full(len(sudden), least[0]), sudden], axis=1)
        least = fitter.with_process(there, fitted.model, any_sudden).process_noise
    # a force that lasts and a sudden one stand in for one another: of what is allowed, the likelier counts
    return _evidence_against(fitter, fitted, least, allowed)


def sudden_force_evidence(fitter: Fitter, fitted: Fitted) -> float:
    """By how much a fit of snapshots is likelier for the sudden force between them; 0 of logs of every sample, and
    where no filter follows without.
    """
    if not fitted.model.logged.of_snapshots:
        return 0.0
    lasting, sudden = fitted.process_noise
    without = np.array([lasting, min(sudden, _sudden(fitter, _relevant(fitted)))])
    found = _evidence_against(fitter, fitted, without)
    return max(found, 0.0) if np.isfinite(found) else 0.0


def _evidence_against(fitter: Fitter, fitted: Fitted, *others: Float[np.ndarray, " 2"]) -> float:
    """By how much a fit is likelier with its own process forces (N) than with the likeliest of others."""
    with_own, *with_others = (fitter.again(fitted, one).cost for one in (fitted.process_noise, *others))
    return min(with_others) - with_own if np.isfinite(with_own) and np.isfinite(min(with_others)) else np.inf


def missing(fitter: Fitter, fitted: Fitted) -> float:
    """What a fit leaves unexplained, of cost."""
    return max(missing_evidence(fitter, fitted), 0.0) + BLOWS * max(lost_samples(fitted) - FEW_LOST, 0)


def is_complete(fitter: Fitter, fitted: Fitted) -> bool:
    """Whether a fit explains the logs to the noise."""
    return lost_samples(fitted) <= FEW_LOST and missing_evidence(fitter, fitted) <= LACKING  # a blow is more than that


def is_lost_throughout(fitter: Fitter, base: Fitted) -> bool:
    """Whether a filter that trusts the recalibrated drive is lost all along, so that its cost says little."""
    return lost_share(fitter, base, least_trusted(fitter)) > BLIND


def power_left(base: Fitted, fitted: Fitted) -> float:
    """Share of the missing force's mean square that is left; between snapshots, of that which lasts."""
    last = 1 if fitted.model.logged.of_snapshots else 2
    return float(np.sum(fitted.process_noise[:last] ** 2) / np.sum(base.process_noise[:last] ** 2))


def share_left(fitter: Fitter, base: Fitted, fitted: Fitted) -> float:
    """Share of what the recalibrated drive is missing that a fit leaves; 0 where nothing is missing any more.

    The details of a coarse effect differ from machine to machine: they leave little force, plain as it may be to see.
    Where the filter was lost in blows, it is those that count; where it was lost all along, how much force it had to
    invent. A filter that runs away explains nothing.
    """
    before, after = max(missing(fitter, base), 1.0), missing(fitter, fitted)
    if not np.isfinite(after):
        return 1.0
    if after <= LACKING:
        return 0.0
    share = after / before if np.isfinite(before) else power_left(base, fitted)
    if fitted.model.coarse or is_lost_throughout(fitter, base):
        share = min(share, power_left(base, fitted))
    if fitted.model.coarse and BLOWS * lost_samples(base) > MOSTLY * before:
        share = min(share, lost_samples(fitted) / lost_samples(base))
    return float(np.clip(share, 0.0, 1.0))


def comparable_parameters(*fits: Fitted) -> Sequence[str]:
    """The nominal parameters that mean what the drive file says in all of the fits: elements before sliding take over
    the others.
    """
    there = {member.candidate.name for one in fits for member in one.model.members}
    return SLIDING if PreslidingHysteresis.name in there else NAMES


def restores_nominal(one: Fitted, other: Fitted, most: float = STRAINED) -> bool:
    """Whether one fit leaves no nominal parameter moved beyond `most` where another does, of those that mean the same
    in both.
    """
    among = comparable_parameters(one, other)
    return max_prior_deviation(other, among) >= most > max_prior_deviation(one, among)


def is_plausible(fitted: Fitted) -> bool:
    """Whether a cause may be believed beside the numbers of a fit; how the bristle bends may be far off."""
    return max_prior_deviation(fitted, SLIDING) <= IMPOSSIBLE


def is_implausible(one: Fitted, other: Fitted) -> bool:
    """Whether one fit rests on numbers that cannot be, where the other does without."""
    return restores_nominal(other, one, IMPOSSIBLE) or (is_plausible(other) and not is_plausible(one))


def max_prior_deviation(fitted: Fitted, among: Sequence[str] | None = None) -> float:
    """By how many standard deviations of the prior the furthest nominal parameter was moved, of `among` or of
    those that are comparable.
    """
    return float(np.abs(_moved(fitted, among or comparable_parameters(fitted))).max())


def largest_deviation_says(fitted: Fitted, among: Sequence[str] | None = None) -> str:
    """In words: which nominal parameter was moved furthest."""
    among = among or comparable_parameters(fitted)
    moved = _moved(fitted, among)
    k = int(np.abs(moved).argmax())
    by = _moves(fitted, among)[0][k]
    added = {FORCE: f"{by:+.3g} N", DELAY: f"{by:+.2g} rows"}
    much = added.get(among[k], f"{100.0 * np.expm1(by):+.1f} %")
    return f"{among[k]} had to be moved by {much}, {abs(moved[k]):.1f} times its tolerance"


def _moved(fitted: Fitted, among: Sequence[str]) -> Float[np.ndarray, " k"]:
    """In standard deviations; what cannot move has none."""
    moves, deviations = _moves(fitted, among)
    return np.divide(moves, deviations, out=np.zeros_like(moves), where=deviations > 0.0)


def _moves(fitted: Fitted, among: Sequence[str]) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """How far the nominal parameters were moved, and their standard deviations before any log."""
    prior, which = fitted.model.prior, [NAMES.index(name) for name in among]
    return (prior @ fitted.theta[: len(NAMES)])[which], np.sqrt(np.sum(prior**2, axis=1))[which]
