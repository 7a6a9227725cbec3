"""Search and filter in turn until neither changes the other, then once more with finer steps of the integrator."""

import dataclasses
import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jaxtyping import Array, Float

from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar, as_arrays
from diffdrive.numerics.directions import along_each
from tuning.identification.filter_gain import PROCESS_FORCES, MostLikely, filter_lanes, most_likely
from tuning.identification.prediction import Prediction
from tuning.identification.problem import FINEST_SUBSTEP, IdentificationProblem, Innovations, compliance_of, sampling_of
from tuning.identification.uncertainty import Covariance, sandwich
from tuning.identification.unknowns import value_at, with_value
from tuning.optimisation.least_squares import LeastSquaresResult, Outcome, StepProgress, levenberg_marquardt
from tuning.store.store import Store, digest

MAX_STEPS, MAX_ROUGH_STEPS = 40, 80  # of each search
MAX_ROUNDS = 15  # of filtering and searching
TRUST = 10.0
MIN_DEVIANCE_GAIN = 1.0  # in deviance, twice the logarithm of the likelihood
TOLERANCE = 1e-6
ROUGH_GAIN, FINE_GAIN = 1e-5, 1e-7  # share of the cost that three steps of a search must gain to be worth going on
OFFSET = 1e-3  # of a search's end: with 15 parameters 4e-3 of a least-squares standard error (`relative_offset`)
INTEGRATOR_ERROR = 1e-2  # N of process force: what steps of `FINE_SUBSTEP` look like to the filter, and more
MAX_CHORDS, SETTLED = 6, 0.01  # steps at a quarter of the substep, and of a standard error, from which on it stays
SMOOTHING, SETTLING = 0.02, 0.1  # s


class RefinedFit(NamedTuple):
    """A refined fit: the last search, the gains it went by, and what it leaves."""

    residuals: Innovations
    problem: IdentificationProblem
    search: LeastSquaresResult
    covariance: Covariance
    slope: Float[np.ndarray, "m k"]  # derivative of the residuals by theta
    innovation: Float[np.ndarray, "lanes n"]  # m; zero where nothing was measured
    velocity: Float[np.ndarray, "lanes n"]  # m/s
    process_force: float = np.inf  # N
    deviance: float = np.inf
    deviance_gain: float = 0.0  # in deviance, of that process over none
    steps: int = 0
    motor_innovation: Float[np.ndarray, "lanes n"] | None = None  # m, of the motor's encoder beside the scale

    def with_prediction(self, predicted: Prediction) -> "RefinedFit":
        """The fit with other innovations, under the same gains."""
        innovation, motor_innovation = _innovations(predicted, self.problem)
        velocity = np.asarray(predicted.velocity)
        return self._replace(innovation=innovation, velocity=velocity, motor_innovation=motor_innovation)


def refine(
    fine: Innovations, theta: Float[np.ndarray, " k"], problem: IdentificationProblem, noise: float,
    progress: StepProgress, store: Store | None = None,
) -> RefinedFit:  # fmt: skip
    """Search and filter in turn, until neither changes the other.

    The first search goes by the constant gains that the problem comes with, which forgive a rough start. Far from the
    truth the filter blames the model and forgives it too much, which makes the next search timid. So each search trusts
    the model `TRUST` times more than the filter would, as long as that makes the log likelier.
    """
    rough = search_once(fine, theta, problem, progress, ROUGH_GAIN, MAX_ROUGH_STEPS, store)
    if was_interrupted(rough):
        return fit_at(fine, problem, rough)._replace(process_force=float(PROCESS_FORCES[-1]), steps=rough.steps)
    fit = _alternate(fine, rough.theta, problem, noise, progress, ROUGH_GAIN, store)
    return fit._replace(steps=rough.steps + fit.steps)


def refine_substeps(fit: RefinedFit, noise: float, progress: StepProgress, store: Store | None = None) -> RefinedFit:
    """The fit at a quarter of the substep, and what the integrator's error may still be, added to its covariance.

    The integrator is of second order, so a sixteenth of its error is left, a fifteenth of how far the estimates moved.
    A model that lacks more force than the integrator errs stays as it is.
    """
    if fit.process_force > INTEGRATOR_ERROR:
        return fit
    finest = dataclasses.replace(fit.residuals, sampling=sampling_of(fit.residuals.sampling.rate, FINEST_SUBSTEP))
    sharp = _by_chords(finest, fit, progress)
    if sharp is None:
        sharp = _alternate(finest, fit.search.theta, fit.problem, noise, progress, FINE_GAIN, store)
    left = (sharp.search.theta - fit.search.theta) / 15.0
    covariance = sharp.covariance._replace(matrix=sharp.covariance.matrix + np.outer(left, left))
    return sharp._replace(covariance=covariance, steps=fit.steps + sharp.steps)


def _by_chords(finest: Innovations, fit: RefinedFit, progress: StepProgress) -> RefinedFit | None:
    """The fit at finer steps of the integrator, under the same gains; None where the chords do not settle.

    theta <- theta - J+ r, with r of the fine steps and J, once, of those that the fit had: they differ by as little as
    the integrator errs, so each chord brings the point nearer by a large factor (Ortega and Rheinboldt 1970, the chord
    method). A Jacobian at the fine steps would cost as much as a dozen chords.
    """
    arrays, theta = as_arrays(fit.problem), fit.search.theta
    errors = np.sqrt(np.diag(fit.covariance.matrix))
    orthogonal, triangle = np.linalg.qr(fit.slope * errors)
    distance = np.inf
    try:
        for count in range(1, MAX_CHORDS + 1):
            residual, predicted = evaluated(finest, jnp.asarray(theta), arrays)
            value = np.asarray(residual)
            if not np.isfinite(value).all():
                return None
            progress(count, MAX_CHORDS, float(np.linalg.norm(value)))
            step = -np.linalg.solve(triangle, orthogonal.T @ value)  # in standard errors
            before, distance = distance, float(np.max(np.abs(step)))
            if distance < SETTLED:
                break
            if distance > 0.5 * before:
                return None
            theta = theta + errors * step
        else:
            return None
    except KeyboardInterrupt:
        return fit._replace(search=fit.search.interrupted())
    search = dataclasses.replace(fit.search, theta=theta, cost=float(np.linalg.norm(value)))
    covariance = _sandwich_of(value, fit.slope, fit.problem, finest.sampling.rate)
    return fit._replace(residuals=finest, search=search, covariance=covariance, steps=0).with_prediction(predicted)


def _innovations(
    predicted: Prediction, problem: IdentificationProblem
) -> tuple[Float[np.ndarray, "lanes n"], Float[np.ndarray, "lanes n"] | None]:
    """Those (m) of the scale and of a motor's encoder; zero where nothing was measured."""
    motor, scale = problem.lanes.motor, np.asarray(predicted.innovation) * np.asarray(problem.lanes.counts)
    return scale, None if motor is None else np.asarray(predicted.motor_innovation) * np.asarray(motor.counts)


def _alternate(
    fine: Innovations,
    theta: Float[np.ndarray, " k"],
    problem: IdentificationProblem,
    noise: float,
    progress: StepProgress,
    min_gain: float,
    store: Store | None,
) -> RefinedFit:
    """Searches under the filter's gains and gains at the search's end, as long as the log becomes likelier."""
    best, steps, trust = most_likely_at(fine, theta, problem, noise), 0, TRUST
    final: tuple[IdentificationProblem, LeastSquaresResult] | None = None
    for _ in range(MAX_ROUNDS):
        process = max(best.process_force / trust, float(PROCESS_FORCES[0]))
        drive, delay, compliance = _machine(fine, theta, problem)
        gains = filter_lanes(drive, delay, process, noise, problem.lanes, fine.sampling, compliance, fine.between).gains
        filtered = problem._replace(gains=jax.tree.map(np.asarray, gains))
        search = search_once(fine, theta, filtered, progress, min_gain, store=store)
        steps += search.steps
        has_moved = not np.array_equal(search.theta, theta)
        new = most_likely_at(fine, search.theta, problem, noise) if has_moved else best
        likelier = new.deviance < best.deviance - MIN_DEVIANCE_GAIN
        if likelier:
            theta, best = search.theta, new
        if likelier or process == best.process_force or final is None:
            final = filtered, search  # in the end the one whose gains are those of the likeliest process
        if was_interrupted(search):
            final = final[0], _ended(final[1], search.outcome, search.status)
            break
        if not likelier and process == best.process_force:
            break
        if not likelier:
            trust = 1.0  # it was too bold: not again
    else:
        assert final is not None  # no round passes without one
        final = final[0], _ended(final[1], Outcome.STOPPED, f"stopped after {MAX_ROUNDS} rounds of filtering")
    assert final is not None
    fit = fit_at(fine, *final)
    return fit._replace(
        process_force=best.process_force, deviance=best.deviance, deviance_gain=best.deviance_gain, steps=steps
    )


def _ended(search: LeastSquaresResult, outcome: Outcome, status: str) -> LeastSquaresResult:
    return dataclasses.replace(search, outcome=outcome, status=status)


def was_interrupted(search: LeastSquaresResult) -> bool:
    """Whether somebody stopped the search."""
    return search.outcome is Outcome.INTERRUPTED


def _machine(
    fine: Innovations, theta: Float[np.ndarray, " k"], problem: IdentificationProblem
) -> tuple[Drive, Scalar, Scalar]:
    """The drive at theta, its delay (control periods) and the compliance of its screw (m/N)."""
    drive, unknowns = fine.unpack(jnp.asarray(theta), problem)
    return drive, unknowns.delay, compliance_of(unknowns)


def most_likely_at(
    fine: Innovations, theta: Float[np.ndarray, " k"], problem: IdentificationProblem, noise: float
) -> MostLikely:
    """The likeliest process force at theta."""
    drive, delay, compliance = _machine(fine, theta, problem)
    return most_likely(drive, delay, noise, problem.lanes, fine.sampling, compliance, fine.between)


def search_once(
    fine: Innovations,
    theta: Float[np.ndarray, " k"],
    problem: IdentificationProblem,
    progress: StepProgress,
    min_gain: float,
    max_steps: int = MAX_STEPS,
    store: Store | None = None,
) -> LeastSquaresResult:
    """One search under given gains; a finished one is kept in the `store`, or taken from there."""
    arrays = as_arrays(problem)
    key = "" if store is None else digest("searched", fine, theta, problem, min_gain, max_steps)
    stored = None if store is None else store.read(key)
    if stored is None:
        search = levenberg_marquardt(
            fine, theta, arrays, max_steps=max_steps, tolerance=TOLERANCE, min_gain=min_gain, min_offset=OFFSET,
            progress=progress,
        )  # fmt: skip
        if store is not None and not was_interrupted(search):
            store.write(key, {name: np.asarray(array) for name, array in dataclasses.asdict(search).items()})
    else:
        values = {name: array.tolist() for name, array in stored.items() if name != "theta"}
        search = LeastSquaresResult(theta=stored["theta"], outcome=Outcome(values.pop("outcome")), **values)
        try:
            progress(search.steps, max_steps, search.cost)
        except KeyboardInterrupt:  # as in the search itself
            search = search.interrupted()
    return search


def fit_at(fine: Innovations, problem: IdentificationProblem, search: LeastSquaresResult) -> RefinedFit:
    """What a search that has ended leaves, and how sure its point is: one more Jacobian."""
    theta, arrays = jnp.asarray(search.theta), as_arrays(problem)
    value, slope = (np.asarray(array) for array in linearised(fine, theta, arrays))
    _, predicted = evaluated(fine, theta, arrays)
    innovation, motor_innovation = _innovations(predicted, problem)
    covariance = _sandwich_of(value, slope, problem, fine.sampling.rate)
    velocity = np.asarray(predicted.velocity)
    return RefinedFit(fine, problem, search, covariance, slope, innovation, velocity, motor_innovation=motor_innovation)


@eqx.filter_jit
def evaluated(
    fine: Innovations, theta: Float[Array, " k"], problem: IdentificationProblem
) -> tuple[Float[Array, " m"], Prediction]:
    """The residuals at theta and what the drive there predicts, compiled."""
    return fine.evaluate(theta, problem)


@eqx.filter_jit
def linearised(
    fine: Innovations, theta: Float[Array, " k"], problem: IdentificationProblem
) -> tuple[Float[Array, " m"], Float[Array, "m k"]]:
    """The residuals at theta, [m], and their derivative, [m, k]."""
    return along_each(lambda theta: fine(theta, problem), theta, axis=1)


def _sandwich_of(
    value: Float[np.ndarray, " m"], slope: Float[np.ndarray, "m k"], problem: IdentificationProblem, rate: float
) -> Covariance:
    """The covariance of theta from the residuals, those of the priors last, and their derivative.

    Two encoders are read in turn: one series of innovations, of twice the rate.
    """
    lanes, samples = problem.lanes.position.shape
    shape, rate = (lanes, samples * problem.lanes.encoders), rate * problem.lanes.encoders
    count = shape[0] * shape[1]
    residual, jacobian = value[:count].reshape(shape), slope[:count].reshape(*shape, -1)
    return sandwich(residual, jacobian, rate, slope[count:])


def without_undetermined(
    fit: RefinedFit, undetermined: set[str]
) -> tuple[Innovations, Float[np.ndarray, " k"], IdentificationProblem]:
    """The problem without the `undetermined` parameters, which go back to what was believed, and theta of the others.

    A believed value outside the bounds goes to the nearer one.
    """
    free, problem = fit.residuals.free, fit.problem
    is_free = np.array([parameter.path not in undetermined for parameter in free])
    unknowns, found = problem.unknowns, fit.residuals.unpack(jnp.asarray(fit.search.theta), problem)[1]
    for (path, _), low, high in zip(free, *np.asarray(problem.bounds), strict=True):
        if path not in undetermined:
            continue
        believed = value_at(problem.believed_unknowns, path)
        stem, _, side = path.partition(".")
        if stem == "breakaway":  # the gap stays, not its ratio to a Coulomb friction that was found to be another
            gap = getattr(problem.believed.friction.breakaway_gap, side)
            level = problem.believed_unknowns if f"coulomb.{side}" in undetermined else found
            believed = 1.0 + float(gap) / value_at(level, f"coulomb.{side}")
        unknowns = with_value(unknowns, path, float(np.clip(believed, low, high)))
    smaller = dataclasses.replace(fit.residuals, free=tuple(itertools.compress(free, is_free)))
    origin, prior = np.asarray(problem.origin)[is_free], np.asarray(problem.prior)[is_free]
    left = problem._replace(
        unknowns=unknowns, origin=origin, bounds=np.asarray(problem.bounds)[:, is_free], prior=prior
    )
    return smaller, fit.search.theta[is_free], left


def missing_force(fit: RefinedFit) -> Float[np.ndarray, "lanes n"]:
    """The force (N) that the filter's corrections of the velocity stand for, averaged over `SMOOTHING`.

    NaN where there is no log, and during `SETTLING`, while the filter finds the velocity and the bristle that the log
    began with.
    """
    drive, _ = fit.residuals.unpack(jnp.asarray(fit.search.theta), fit.problem)
    sampling = fit.residuals.sampling
    gains, momentum_rate = fit.problem.gains, float(drive.plant.mass) * sampling.rate
    force = momentum_rate * np.asarray(gains.velocity) * fit.innovation
    if gains.motor is not None and fit.motor_innovation is not None:
        force = force + momentum_rate * np.asarray(gains.motor.velocity) * fit.motor_innovation
    width = max(1, round(SMOOTHING * sampling.rate))
    counts = np.asarray(fit.problem.lanes.counts)
    total, number = (scipy.ndimage.uniform_filter1d(one, width, axis=1, mode="constant") for one in (force, counts))
    smoothed = np.where(counts > 0, total / np.maximum(number, 0.5 / width), np.nan)
    smoothed[:, : round(SETTLING * sampling.rate)] = np.nan
    return smoothed


def leading_innovation(fit: RefinedFit) -> tuple[Float[np.ndarray, "lanes n"], Float[np.ndarray, "lanes n"]]:
    """The innovations (m) of the finer encoder, and how far they were expected to scatter.

    Beside it, those of the coarser one are its own errors: its counts, and what the screw makes of them.
    """
    motor, gains = fit.problem.lanes.motor, fit.problem.gains
    if motor is None or gains.motor is None or fit.motor_innovation is None:
        return fit.innovation, np.asarray(gains.innovation_std)
    leads = np.asarray(motor.counts * motor.leads[:, None]) > 0
    std = np.where(leads, np.asarray(gains.motor.innovation_std), np.asarray(gains.innovation_std))
    return np.where(leads, fit.motor_innovation, fit.innovation), std


def normalised_innovations(fit: RefinedFit) -> Float[np.ndarray, "lanes m"]:
    """Innovations in standard deviations, those of two encoders in turn: what the fit makes small."""
    motor, gains = fit.motor_innovation, fit.problem.gains
    scale = fit.innovation / np.asarray(gains.innovation_std)
    if motor is None or gains.motor is None:
        return scale
    both = np.stack([scale, motor / np.asarray(gains.motor.innovation_std)], axis=-1)
    return both.reshape(len(scale), -1)


def coulomb_level(fit: RefinedFit) -> float:
    """Coulomb friction (N) at no load, the scale against which missing forces count."""
    unknowns = fit.residuals.unpack(jnp.asarray(fit.search.theta), fit.problem)[1]
    return 0.5 * float(unknowns.coulomb.positive + unknowns.coulomb.negative)
