"""How far the gap shrinks once an effect is added, on logs that were not fitted.

The machine's parameters are fitted on some of the logs and carried over; those of the session (phases, times) are
registered anew on the others. Which samples those are, `splitting` says.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from diffdrive.controllers import Controller
from diffdrive.logs import Log
from tuning.diagnosis.blocks import block_sums
from tuning.diagnosis.filter.ekf import EkfResult
from tuning.diagnosis.fits.fitted import Fitted, last_candidate
from tuning.diagnosis.fits.fitting import NEAR, Fitter
from tuning.diagnosis.fits.reference_noise import Forces, least_following, reference_process_noise
from tuning.diagnosis.fits.threads import in_parallel
from tuning.diagnosis.gap.gap import ForceGap, LoopGap, drive_of, force_floor, force_gap, loop_gap, uncoupled
from tuning.diagnosis.gap.splitting import Split, determined, of_session, split
from tuning.diagnosis.levels import LOST
from tuning.diagnosis.selection.explanation import Explanation

CARRY, REGISTER = 6, 4  # steps of the fit to the training logs, and of the registration


class ModelComparison(NamedTuple):
    """One model on the logs that were held out."""

    name: str
    fitted: Fitted
    force: ForceGap
    interval: tuple[float, float]  # N
    floor: float  # N: what measuring noise, and what is not known of the command, make where nothing is lacking
    shrink: tuple[float, float, float]  # of the mean square of the force against the nominal drive: value, interval
    loop: LoopGap | None
    unlikely: Float[np.ndarray, " pieces"]  # -2 log probability of each piece of what is held out, as `deviance`
    trusting: Forces  # N: process forces of the filter that tells the missing force

    @property
    def deviance(self) -> float:
        """-2 log probability of what is held out, up to a constant shared by the models."""
        return float(np.sum(self.unlikely))


def known_floor(comparisons: list[ModelComparison], comparison: ModelComparison) -> float | None:
    """N: the floor of one of the models; None where it cannot be told. With effects within the filter it may be the
    recalibrated drive's.
    """
    filtered = comparisons[1] if comparison.fitted.model.coupled else comparison
    return comparison.floor if filtered.force.is_known and np.isfinite(comparison.floor) else None


def _weighted(fitter: Fitter, counts: Float[np.ndarray, "lanes n"]) -> Fitter:
    lanes = fitter.logged.lanes._replace(counts=np.asarray(counts))  # type: ignore[arg-type]  # jit takes numpy's too
    twist = fitter.twist and fitter.twist._replace(counts=fitter.twist.counts * (np.asarray(counts) > 0))
    return Fitter(fitter.logged._replace(lanes=lanes), twist, fitter.store)


def _at_control(fitter: Fitter, counts: Float[np.ndarray, "lanes n"], log: int) -> Float[np.ndarray, "pieces n"]:
    """The weights of one log's pieces, at every control period."""
    mine = [lane for lane, owner in enumerate(fitter.logged.owner) if owner == log]
    return np.repeat(counts[mine], fitter.logged.thinning, axis=1)


def _unlikely(filtered: EkfResult, counts: Float[np.ndarray, "lanes n"], rate: float) -> Float[np.ndarray, " pieces"]:
    """The filter's deviance, less the number of samples, in pieces of time."""
    size, scatter = float(filtered.noise_scale_sq), np.asarray(filtered.innovation_std)
    squares = np.minimum(np.asarray(filtered.normalised_innovation) ** 2, LOST**2)
    each = counts * (squares / size - 1.0 + np.log(size) + 2.0 * np.log(scatter))
    return block_sums(each, rate)[block_sums(counts, rate) > 0]


def _told_by(fitter: Fitter, one: Fitted, process_noise: Forces) -> tuple[ForceGap, Forces]:
    """The missing force of a model and the process noise of its filter: the common one, or one of its own where that
    filter is lost, or where a transmission was found and needs less that lasts.
    """
    gap = force_gap(fitter, one, process_noise)
    own = least_following(fitter, one) if one.model.screw_found or not gap.is_known else None
    if own is None or (gap.is_known and own[0] >= process_noise[0]):
        return gap, process_noise
    return force_gap(fitter, one, own), own


def compare_models(
    fitter: Fitter, found: Explanation, logs: list[Log], controller: Controller | None
) -> tuple[list[ModelComparison], Split]:
    """Nominal, recalibrated, with one effect, with the next; simulated in closed loop where a controller is given and a
    log that is judged by has a reference.
    """
    parts = split(fitter, found.best)
    train, there, test = (_weighted(fitter, each) for each in (parts.train, parts.register, parts.test))
    base = found.base
    chain = [("recalibrated", base)]
    for number in range(found.best.model.added):
        one = found.rounds[number].fits[0]
        chain.append((f"+ {last_candidate(one).name}", one))
    believed = base.model.on(test.logged)
    still = test.fit(believed, np.zeros(base.model.size), base.process_noise, base.filtered.trajectory, 0)

    def judged_by(one: Fitted) -> Fitted:
        model = one.model.on(train.logged)
        # what is of the session that is held out stays, to be registered from there: without data it would drift away
        away = model.mask(lambda _member, _name, log: log in parts.whole)
        unknown = away if parts.whole else of_session(model) & ~determined(one, parts.train > 0)
        trained = train.refit(one, model, CARRY, 1.0 - unknown)
        session = model.mask(lambda _member, _name, log: log is not None).astype(float)
        theta = trained.theta
        if parts.whole and session.any():
            model = one.model.on(there.logged)
            theta = there.fit(model, theta, one.process_noise, one.filtered.trajectory, REGISTER, session).theta
        model = one.model.on(test.logged)
        return test.fit(model, theta, one.process_noise, one.filtered.trajectory, 0)

    carried = in_parallel(judged_by, [one for _, one in chain])
    fits = [("nominal", still), *zip([name for name, _ in chain], carried, strict=True)]
    rate = fitter.logged.sampling.rate
    process_noise = reference_process_noise(test, fits[1][1])
    told_by = [(force_gap(test, one, process_noise), process_noise) for _, one in fits[:2]]
    told_by += [_told_by(test, one, process_noise) for _, one in fits[2:]]
    gaps = [gap for gap, _ in told_by]
    common = np.prod([gap.counts for gap in gaps], axis=0)  # each has its own velocity, and slides where that says so
    gaps = [gap.where(common) for gap in gaps] if common.any() else gaps
    drawn = [gap.drawn(rate) for gap in gaps]
    closable = [log for log in parts.logs if logs[log].reference is not None]
    judged, at_control = [logs[log] for log in closable], [_at_control(fitter, parts.test, log) for log in closable]

    def comparison(asked: tuple[tuple[str, Fitted], ForceGap, Forces, Float[np.ndarray, " draws"]]) -> ModelComparison:
        (name, one), gap, process_noise, squares = asked
        # how far a model is trusted is chosen anew: one that fitted to the noise may be a little off elsewhere
        there = test.again(one)
        processes = np.vstack([one.process_noise * NEAR, test.first, test.quiet(one.process_noise)])
        likeliest = test.with_process(there, one.model, processes)
        ratio = 1.0 - squares / drawn[0]
        low, high = (float(x) for x in np.percentile(ratio, [2.5, 97.5]))
        # with effects within the filter what noise makes of it is no linear matter, and may seem to grow without end
        alike = [one, uncoupled(test, fits[1][1])] if one.model.coupled else [one]
        floors = [force_floor(test, each, gap.counts, process_noise) for each in alike]
        floor = min((each for each in floors if np.isfinite(each)), default=np.inf)
        loop = None
        if controller is not None and closable:
            drives = [drive_of(one, log) for log in closable]
            loop = loop_gap(drives, controller, judged, at_control, float(fitter.logged.noise), fitter.logged.control)
        shrink = (1.0 - (gap.rms / gaps[0].rms) ** 2, low, high)
        return ModelComparison(
            name, one, gap, gap.interval(rate), floor, shrink, loop,
            _unlikely(likeliest.filtered, parts.test, rate), process_noise,
        )  # fmt: skip

    trusting = [one for _, one in told_by]
    return in_parallel(comparison, list(zip(fits, gaps, trusting, drawn, strict=True))), parts
