"""The diagnosis of the gap between a drive and its logs, from end to end.

logs -> recalibrate -> screen, fit, judge -> ladder on held-out data -> where -> which motion would decide
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.stats import chi2

from diffdrive.controllers import Controller, UnknownController
from diffdrive.effects.catalogue import effects_by_part, require_effects
from diffdrive.effects.scale import LeadError
from diffdrive.errors import LogError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive, Sampling, require_coulomb_friction
from diffdrive.model.uncertainty import Uncertainty
from diffdrive.numerics.arrays import as_arrays
from diffdrive.support.rates import is_same_rate
from tuning.diagnosis.filter.effect_signals import in_parts
from tuning.diagnosis.filter.second_encoder import twist_of
from tuning.diagnosis.fits.fitted import Fitted, last_candidate
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import (
    SLIDING,
    is_complete,
    is_plausible,
    largest_deviation_says,
    max_prior_deviation,
)
from tuning.diagnosis.fits.reference_noise import reference_process_noise
from tuning.diagnosis.gap.dependence import Dependence, dependences
from tuning.diagnosis.gap.gap import ForceGap, floor_of, force_gap, force_noise, uncoupled
from tuning.diagnosis.gap.laps import Laps, laps
from tuning.diagnosis.gap.splitting import Split
from tuning.diagnosis.gap.where import Region, localise
from tuning.diagnosis.hypotheses.calibration import TOLERANCE
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.catalogue import candidates, given
from tuning.diagnosis.hypotheses.excitation import excitation_deficits
from tuning.diagnosis.hypotheses.model import Logged, Member, counted_in, thinned
from tuning.diagnosis.hypotheses.setting import setting
from tuning.diagnosis.judgement.command_left import downgraded_by_command
from tuning.diagnosis.judgement.events import downgraded_by_event
from tuning.diagnosis.judgement.held_out import (
    GapReduction,
    confirmed,
    gap_reduction,
    gap_reductions,
    is_hidden,
    left_in_loop,
    prune_on_validation,
)
from tuning.diagnosis.judgement.ladder import ModelComparison, compare_models, known_floor
from tuning.diagnosis.judgement.rest import Rest
from tuning.diagnosis.judgement.verdict import Verdict, judge
from tuning.diagnosis.levels import LACKING, STRAINED
from tuning.diagnosis.limits.detection import DetectionLimit, allowed, detection_limits, small_amounts
from tuning.diagnosis.limits.isolability import Rivalry, rivalries
from tuning.diagnosis.selection.explain import MOST_EFFECTS, evidence_needed, explain, is_looked_for
from tuning.diagnosis.selection.explanation import Explanation
from tuning.diagnosis.selection.search import Progress, recalibrated
from tuning.diagnosis.selection.snapshots import read_snapshots
from tuning.diagnosis.selection.stages import Tell, of_gap, unheard
from tuning.diagnosis.selection.step_size import with_step_short_enough
from tuning.identification.padding import padded
from tuning.identification.problem import MIN_LANE_SAMPLES, lanes_of, long_pieces, noise_floor, sampling_of
from tuning.identification.shown_motion import ExcitationDeficit
from tuning.store.store import Store

SUBSTEP = 50e-6  # s
ENOUGH = 2000.0  # Hz: faster logs are thinned, to no less than this
SAME_RATE = 1e-3  # relative


@dataclass(frozen=True)
class Diagnosis:
    """What the logs say about the drive."""

    logged: Logged
    explanation: Explanation
    verdict: Verdict
    where: list[Region]
    gap: ForceGap  # of the recalibrated drive
    comparisons: list[ModelComparison]
    split: Split
    excitation_deficits: list[ExcitationDeficit]
    laps: Laps | None  # where a reference repeats, and the missing force can be told
    limits: list[DetectionLimit]  # what the logs would have shown of each effect that was not found
    alike: list[Rivalry]  # what they would have shown, and not told from another effect
    left: list[Dependence] | None  # what would explain what is left, the likeliest first; None: not looked for
    rest: Rest | None = None  # of long logs, what becomes of the stretches that were not diagnosed

    @property
    def floor(self) -> float | None:
        """N: the force that the measuring noise alone would make, on what is held out; None where it cannot be told."""
        return known_floor(self.comparisons, self.comparisons[-1])

    @property
    def closed(self) -> GapReduction | None:
        """How far what was found closes the gap that is held out; None where nothing was found, nothing was left, or
        recalibration hides it.
        """
        return _closed(self.explanation, self.comparisons, self.logged.sampling.rate)

    @property
    def found(self) -> Fitted:
        """The drive with everything that was found."""
        return self.explanation.best


def logged_of(drive: Drive, logs: Sequence[Log], loop_samples: int = 1) -> Logged:
    """The logs as the diagnosis takes them, whose rows are the first of so many samples of the loop; the drive's own
    effects are no part of it.
    """
    for log in logs:
        if not long_pieces(log):
            mend = "leave this log out" if len(logs) > 1 else "log a longer motion"
            raise LogError(f"{log.name}: no stretch of {MIN_LANE_SAMPLES} samples without a gap: {mend}")
        if not is_same_rate(log.rate, logs[0].rate, SAME_RATE):
            raise LogError(
                f"{log.name} is sampled at {log.rate:g} Hz, {logs[0].name} at {logs[0].rate:g} Hz: diagnose logs of "
                "one rate together"
            )
    drive = dataclasses.replace(drive, effects=())
    thinning = max(1, int(logs[0].rate * (1.0 + SAME_RATE) / ENOUGH))  # a clock is never quite right
    lanes = thinned(lanes_of(list(logs)), thinning)
    owner = tuple(k for k, log in enumerate(logs) for _ in long_pieces(log))
    actuator = drive.actuator
    delay = jnp.asarray(actuator.delay_samples + float(actuator.delay_fraction or 0.0)) / thinning
    rate = float(round(logs[0].rate / thinning, 6))
    noise = jnp.asarray(noise_floor(drive, lanes, rate))
    sampling = Sampling(rate, thinning * sampling_of(logs[0].rate, SUBSTEP).plant_steps)
    is_fast = loop_samples == 1 or thinning > 1
    if is_fast and float(delay) * thinning % 1.0:  # the force changes within a control period
        asked = in_parts(lanes.command, 1) if lanes.period_commands is None else lanes.period_commands
        parts = jnp.repeat(asked, sampling.plant_steps // asked.shape[2], axis=2)
        lanes = lanes._replace(period_commands=parts)
    starts = jnp.asarray([float(log.time[piece.start] - log.time[0]) for log in logs for piece in long_pieces(log)])
    logged = Logged(as_arrays(drive), delay, padded(lanes), owner, noise, sampling, starts, thinning)
    return logged if is_fast else read_snapshots(logged, logs, loop_samples)


def diagnose(
    drive: Drive,
    controller: Controller,
    logs: Sequence[Log],
    *,
    without: Sequence[str] = (),
    tolerance: float = TOLERANCE,
    most_effects: int = MOST_EFFECTS,
    loop_samples: int = 1,
    uncertainty: Uncertainty | None = None,
    store: Store | None = None,
    progress: Progress = lambda what, done, most: None,
    tell: Tell = unheard,
) -> Diagnosis:
    """Find what a drive lacks to move as its logs do.

    `without` are effects that are not to be considered; `tolerance` is the standard deviation of the logarithm of each
    nominal parameter, to which comes what `uncertainty` says of them; `most_effects` is how many are looked for, one
    after the other; a row of the logs is the first of `loop_samples` of the control. Effects that the drive has stay as
    they are. Finished searches are kept in the `store`, and taken from there when the diagnosis is begun again. What is
    known on the way is told by `tell`.

    Raises `LogError` for a log without a long enough piece, and `ParameterError` for a drive that no filter can run and
    for effects that the catalogue has not.
    """
    require_coulomb_friction(drive, "a diagnosis")
    logged = logged_of(drive, logs, loop_samples)
    require_effects(without, "without")
    effects = [counted_in(one, logged.thinning) for one in drive.effects]
    fitter = Fitter(logged, twist_of(logs, logged.lanes, float(logged.noise), logged.thinning), store)
    at = setting(logged.drive, logged.lanes, logged.sampling.period, logged.thinning, logged.starts)
    deficits = excitation_deficits(logged, at)
    progress("recalibrating", 0, 1)
    base = recalibrated(fitter, tolerance, tuple(Member(*one) for one in given(effects, at)), uncertainty)
    fitter, base = with_step_short_enough(fitter, base)
    logged = fitter.logged
    progress("recalibrating", 1, 1)
    lead = next((float(one.lead) for one in drive.effects if isinstance(one, LeadError)), None)
    early = _missing_force(fitter, base)
    tell(of_gap(early.gap, early.floor, is_complete(fitter, base), _located(logged, early, lead, ())))
    catalogue = [one for one in candidates(at) if one.name not in without]
    hopeless = any(one.hopeless for one in deficits)
    found = Explanation(base, [], base) if hopeless else explain(fitter, base, catalogue, progress, most_effects, tell)
    progress("judging on held-out data", 0, 1)
    comparisons, parts = compare_models(
        fitter, found, list(logs), None if isinstance(controller, UnknownController) else controller
    )
    before_pruning, (found, comparisons) = found, prune_on_validation(found, comparisons)
    share = _closed(found, comparisons, logged.sampling.rate)
    verdict = judge(fitter, found, left_in_loop(comparisons), gap_reductions(found, comparisons, logged.sampling.rate))
    verdict = _credible(confirmed(verdict, comparisons, share), found.best)
    verdict = downgraded_by_event(downgraded_by_command(verdict, found), found.best)
    verdict = _within(verdict, deficits)
    if before_pruning.best.model.added > found.best.model.added:
        last = last_candidate(found.rounds[found.best.model.added].fits[0]).name
        verdict = verdict.and_says(f"{last} was withdrawn, since the held-out data are predicted worse with it")
    if without:
        verdict = verdict.and_says(f"not looked for: {', '.join(without)}")
    missing = early if found.base is base else _missing_force(fitter, found.base)  # it may have been led further
    where, gap = _located(logged, missing, lead, _subsystems(found, verdict.unexplained)), missing.gap
    progress("judging on held-out data", 1, 1)
    progress("finding what these logs would show", 0, 1)
    searched = bool(most_effects) and not hopeless
    limits, alike = _limits_and_rivalries(fitter, found, catalogue) if searched else ([], [])
    left = dependences(fitter, found.best, at) if searched and _is_lacking(fitter, found, verdict) else None
    progress("finding what these logs would show", 1, 1)
    again = laps(logs, gap.force, gap.counts, logged.owner, logged.thinning) if gap.is_known else None
    where = [*where, *_signals(comparisons)]
    return Diagnosis(logged, found, verdict, where, gap, comparisons, parts, deficits, again, limits, alike, left)


class _MissingForce(NamedTuple):
    """The force that a drive lacks along the logs, and what noise alone would make of a model that lacks nothing."""

    gap: ForceGap
    noise: Float[np.ndarray, "lanes n draws"]  # N
    command_std: float  # N

    @property
    def floor(self) -> float:
        """Root mean square (N) of the noise, over the samples that count, and of what is not known of the command."""
        return floor_of(self.noise, self.gap.counts, self.command_std)


def _missing_force(fitter: Fitter, base: Fitted) -> _MissingForce:
    trusting = reference_process_noise(fitter, base)
    gap = force_gap(fitter, base, trusting)
    noise = force_noise(fitter, uncoupled(fitter, base), trusting)
    return _MissingForce(gap, noise, float(fitter.logged.command_std))


def _located(logged: Logged, missing: _MissingForce, lead: float | None, others: Sequence[Region]) -> list[Region]:
    return localise(
        missing.gap, logged.lanes, logged.owner, logged.sampling.rate,
        starts=logged.starts, noise=missing.noise, lead=lead, others=others,
    )  # fmt: skip


def _is_lacking(fitter: Fitter, found: Explanation, verdict: Verdict) -> bool:
    """Whether something is left, and nothing that was found is believed."""
    return verdict.verdict == "unknown" and not is_complete(fitter, found.best)


def _limits_and_rivalries(
    fitter: Fitter, found: Explanation, catalogue: Sequence[Candidate]
) -> tuple[list[DetectionLimit], list[Rivalry]]:
    """From which size on the logs would have shown an effect that was not found, and excluded others in its place."""
    fitted = allowed(fitter, found.best)
    if fitted is None:
        return [], []
    amounts = small_amounts(fitter, fitted, catalogue)
    limits = detection_limits(fitter, fitted, _sought(fitter, found, catalogue), amounts, _needed(fitter, found))
    return limits, rivalries(fitter, fitted, amounts, limits)


def _sought(fitter: Fitter, found: Explanation, catalogue: Sequence[Candidate]) -> Sequence[Candidate]:
    """The effects whose presence the logs would have shown; of snapshots that lack no force, those looked for alone."""
    logged, base = fitter.logged, found.base
    if not (logged.of_snapshots and is_complete(fitter, base)):
        return catalogue
    seen, moved = fitter.twist is not None, max_prior_deviation(base) >= STRAINED
    return [one for one in catalogue if is_looked_for(one, logged, seen, moved)]


def _needed(fitter: Fitter, found: Explanation) -> float:
    """The evidence that one more effect must bring to be looked for, and believed."""
    return max(LACKING, evidence_needed(fitter, found.base, found.best, is_complete(fitter, found.best), ()))


def _closed(found: Explanation, comparisons: list[ModelComparison], rate: float) -> GapReduction | None:
    return None if len(comparisons) == 2 or is_hidden(found) else gap_reduction(comparisons[1], comparisons[-1], rate)


def _credible(verdict: Verdict, best: Fitted) -> Verdict:
    """No sure cause beside a number that no machine of this drive file has."""
    if verdict.verdict != "effect" or is_plausible(best):
        return verdict
    return verdict.downgraded(
        f"{largest_deviation_says(best, SLIDING)}, which cannot be: something else acts as well, or instead"
    )


def _within(verdict: Verdict, excitation_deficits: list[ExcitationDeficit]) -> Verdict:
    """No sure cause from logs that cannot tell it."""
    if not excitation_deficits:
        return verdict
    says = "; ".join(f"{one.why}: {one.what} cannot be decided, log {one.motion}" for one in excitation_deficits)
    return verdict.downgraded(says) if verdict.beliefs else verdict._replace(verdict="unknown", says=says)


def _subsystems(found: Explanation, unexplained: float) -> list[Region]:
    """How much of what is missing a change in each place of the machine could explain, as far as it was tried.

    What was found explains all of it but for what is `unexplained`.
    """
    if not found.best.model.added:
        return []
    first = found.rounds[0]
    total = max(found.base.cost - found.best.cost, 1e-9) / max(1.0 - unexplained, 1e-9)
    gained = [(one.candidate, one.gain) for one in reversed(first.screened)]  # the best of each name last
    gained += [(last_candidate(one), first.before.cost - one.cost) for one in first.fits]
    gains = {candidate.name: gain for candidate, gain in gained}
    freedom = {candidate.name: max(len(candidate.parameters), 1) for candidate, _ in gained}
    regions = []
    for place, effects in effects_by_part().items():
        here = [(gains[effect.name], effect.name) for effect in effects if effect.name in gains]
        if not here:
            continue
        best = max(here)
        chance = min(1.0, len(here) * float(chi2.sf(max(best[0], 0.0), freedom[best[1]])))  # the best of so many
        share = float(np.clip(best[0] / total, 0.0, 1.0))
        says = f"a change in the {place} ({best[1]}) would explain {100 * share:.0f} % of it"
        regions.append(Region("subsystem", place, share, 0.0, chance, says))
    return regions


def _signals(comparisons: list[ModelComparison]) -> list[Region]:
    """Whether the gap shows in the position or, behind a stiff loop, in the command; no chance is known of that."""
    loop = comparisons[1].loop
    if loop is None or loop.says:
        return []
    floors = np.array([loop.position_floor, loop.command_floor])
    if not np.all(floors > 0.0):
        return []
    over = np.array([loop.position_rms, loop.command_rms]) / floors
    excess = np.maximum(over**2 - 1.0, 0.0)
    shares = excess / max(excess.sum(), 1e-9)
    return [
        Region("signal", name, float(share), 0.5, 1.0, f"{name}: {one:.2g} times its floor in closed loop")
        for name, share, one in zip(("position", "command"), shares, over, strict=True)
    ]
