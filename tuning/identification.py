"""Friction, mass and delay of a drive from its logs, by gradient.

    logs -> inverse dynamics (a start) -> many starts, coarse -> one search, every sample -> intervals -> what is determined

A parameter that the logs do not determine is put back to what the drive file says, named, and the rest fitted again.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.ndimage
from jaxtyping import Array, Float

from diffdrive.errors import DiffdriveError, LogError, ParameterError
from diffdrive.logs import Log
from diffdrive.parameters import Directional, Drive, as_arrays, check_drive, require_double_precision
from tuning import inverse_dynamics
from tuning.adequacy import Adequacy, adequacy
from tuning.estimates import Estimate, estimates
from tuning.filtering import likeliest, track
from tuning.fit import (
    COARSE_SUBSTEP,
    FINE_SUBSTEP,
    FINEST_SUBSTEP,
    Innovations,
    Problem,
    lanes_of,
    noise_floor,
    sampling_of,
)
from tuning.least_squares import Progress, Search, levenberg_marquardt, many_starts, silent
from tuning.prediction import Predicted, constant_gains
from tuning.regressors import DIRECTIONAL
from tuning.seed import seed_drive
from tuning.space import Free, space_of
from tuning.uncertainty import Covariance, sandwich
from tuning.unknowns import Unknowns, bounds, paths, unknowns_of

SCATTERED = ("breakaway", "stribeck_velocity", "bristle_stiffness", "bristle_damping", "delay")
COARSE_EVERY = 8  # samples; the many starts look at each n-th innovation
COARSE_STEPS = 8
MOST_STEPS = 15  # of each search
MOST_ROUNDS = 12  # of filtering and searching
SETTLED = 0.1  # standard errors; a round that moves no parameter further is the last
TOLERANCE = 1e-6
ROUGH_BANDWIDTH = 200.0  # rad/s, of the coarse searches: above the fastest growth on a falling Stribeck curve
SMOOTHING = 0.02  # s
UNDETERMINED = 0.35  # standard error in units of the prior: the log hardly narrows a factor of ten
INSEPARABLE = 0.95  # correlation
NAMES = {  # in the drive file -> in the search
    "mass": "mass",
    "constant_force": "constant_force",
    "coulomb_screw": "coulomb",
    "load_coefficient": "load_coefficient",
    "breakaway_gap": "breakaway",
    "stribeck_velocity": "stribeck_velocity",
    "viscous": "viscous",
    "bristle_stiffness": "bristle_stiffness",
    "bristle_damping": "bristle_damping",
    "delay": "delay",
}


@dataclass(frozen=True)
class Identified:
    """The drive that the logs tell, how sure each of its parameters is, and whether the model suffices."""

    drive: Drive
    estimates: list[Estimate]
    adequacy: Adequacy
    covariance: Covariance
    correlated: list[tuple[str, str, float]]  # pairs that the logs hardly tell apart
    noise: float  # m
    process: float  # N, standard deviation of the force that the model lacks, were it white
    innovation: Float[np.ndarray, "lanes n"]  # m
    missing: Float[np.ndarray, "lanes n"]  # N, force that the corrections stand for
    velocity: Float[np.ndarray, "lanes n"]  # m/s, as predicted
    search: Search
    starts: Float[np.ndarray, " s"]  # cost of each start, over the best
    simulations: int  # of all logs, forward and with derivatives
    notes: tuple[str, ...]

    @property
    def status(self) -> str:
        """What to make of it; never just "converged" over structured innovations."""
        if self.search.status != "converged":
            return self.search.status
        return "converged, but structure remains" if self.adequacy.structured else "converged"


def identify(
    logs: Sequence[Log],
    drive: Drive,
    *,
    fixed: Sequence[str] = (),
    bounded: Mapping[str, tuple[float, float]] | None = None,
    starts: int = 6,
    seed: int = 0,
    progress: Progress = silent,
) -> Identified:
    """Identify `drive` from `logs` of one machine (all at one rate), starting from what it says.

    `fixed` names parameters (as in the drive file) that stay, `bounded` those with bounds of their own. Loads must be in
    the logs where they differ. Raises `LogError` where a log cannot be used and `ParameterError` for unknown names.
    """
    require_double_precision()
    check_drive(drive)
    rate = _one_rate(logs)
    lanes = lanes_of(list(logs))
    seeded, notes = _seeded(drive, logs)
    delay = drive.actuator.delay_samples + float(drive.actuator.delay_fraction or 0.0)
    noise = noise_floor(drive, lanes)
    problem = Problem(
        believed=drive,
        believed_unknowns=unknowns_of(drive, delay),
        unknowns=unknowns_of(seeded, delay),
        lanes=lanes,
        gains=constant_gains(ROUGH_BANDWIDTH, noise, lanes, 1.0 / rate),
        origin=np.zeros(0),
    )
    held = _held(fixed)
    if np.ptp(np.asarray(lanes.load)[np.asarray(lanes.counts) > 0]) < _least_load(drive):
        held.add("load_coefficient")
    problem, free = _space(_without(problem, held), held, bounded or {})
    y, costs = _scattered(Innovations(free, sampling_of(rate, COARSE_SUBSTEP), COARSE_EVERY), problem, starts, seed, progress)
    fit = _refined(Innovations(free, sampling_of(rate, FINE_SUBSTEP)), y, problem, noise, progress)
    lost = _undetermined(free, fit.covariance)
    if lost:
        fit = _refined(*_narrowed(fit, lost), noise, progress)
    fit = _sharpened(fit, noise, progress)
    return Identified(
        drive=_with_delay(*jax.tree.map(float, fit.residuals.unpack(jnp.asarray(fit.search.y), fit.problem))),
        estimates=estimates(fit.search.y, fit.residuals, fit.problem, fit.covariance, lost),
        adequacy=adequacy(
            fit.innovation / np.asarray(fit.problem.gains.scatter), fit.gain, _missing(fit), _friction(fit)
        ),
        covariance=fit.covariance,
        correlated=_correlated(fit.residuals.free, fit.covariance),
        noise=noise,
        process=fit.process,
        innovation=fit.innovation,
        missing=_missing(fit),
        velocity=fit.velocity,
        search=fit.search,
        starts=costs / costs.min(),
        simulations=(COARSE_STEPS * starts + fit.steps) * (1 + len(free)),
        notes=tuple(notes),
    )


class Fit(NamedTuple):
    """A refined fit: the last search, the gains it went by, and what it leaves."""

    residuals: Innovations
    problem: Problem
    search: Search
    covariance: Covariance
    innovation: Float[np.ndarray, "lanes n"]  # m; zero where nothing was measured
    velocity: Float[np.ndarray, "lanes n"]  # m/s
    process: float = np.inf  # N
    gain: float = 0.0  # in deviance, of that process over none
    steps: int = 0


def _refined(
    fine: Innovations, y: Float[np.ndarray, " k"], problem: Problem, noise: float, progress: Progress
) -> Fit:
    """Search and filter in turn, until the filter's gains no longer change what is found."""
    steps, process = 0, np.inf
    for _ in range(MOST_ROUNDS):
        drive, unknowns = fine.unpack(jnp.asarray(y), problem)
        before = process
        process, gain, filtered = likeliest(drive, unknowns.delay, noise, problem.lanes, fine.sampling)
        problem = problem._replace(gains=jax.tree.map(np.asarray, filtered.gains))
        fit = _searched(fine, y, problem, progress)
        errors = np.sqrt(np.diag(fit.covariance.matrix))
        settled = process == before and np.max(np.abs(fit.search.y - y) / errors) < SETTLED
        y, steps = fit.search.y, steps + fit.search.steps
        if settled and fit.search.status == "converged":
            break
    return fit._replace(process=process, gain=gain, steps=steps)


def _searched(fine: Innovations, y: Float[np.ndarray, " k"], problem: Problem, progress: Progress) -> Fit:
    """One search under given gains."""
    given = as_arrays(problem)
    search = levenberg_marquardt(fine, y, given, max_steps=MOST_STEPS, tolerance=TOLERANCE, progress=progress)
    predicted, covariance = _predict(fine, jnp.asarray(search.y), given), _covariance(fine, search.y, problem)
    innovation = np.asarray(predicted.innovation) * np.asarray(problem.lanes.counts)
    return Fit(fine, problem, search, covariance, innovation, np.asarray(predicted.velocity))


def _sharpened(fit: Fit, noise: float, progress: Progress) -> Fit:
    """The fit at a quarter of the substep, and what the integrator's error may still be, added to its covariance.

    The integrator is of second order, so a sixteenth of its error is left, a fifteenth of how far the estimates moved.
    """
    finest = dataclasses.replace(fit.residuals, sampling=sampling_of(fit.residuals.sampling.rate, FINEST_SUBSTEP))
    drive, unknowns = finest.unpack(jnp.asarray(fit.search.y), fit.problem)
    filtered = track(drive, unknowns.delay, fit.process, noise, fit.problem.lanes, finest.sampling)
    problem = fit.problem._replace(gains=jax.tree.map(np.asarray, filtered.gains))
    sharp = _searched(finest, fit.search.y, problem, progress)
    left = (sharp.search.y - fit.search.y) / 15.0
    covariance = sharp.covariance._replace(matrix=sharp.covariance.matrix + np.outer(left, left))
    return sharp._replace(
        covariance=covariance, process=fit.process, gain=fit.gain, steps=fit.steps + sharp.search.steps
    )


def _missing(fit: Fit) -> Float[np.ndarray, "lanes n"]:
    """The force (N) that the filter's corrections of the velocity stand for, averaged over `SMOOTHING`."""
    drive, _ = fit.residuals.unpack(jnp.asarray(fit.search.y), fit.problem)
    sampling = fit.residuals.sampling
    force = float(drive.plant.mass) * sampling.rate * np.asarray(fit.problem.gains.velocity) * fit.innovation
    width = max(1, round(SMOOTHING * sampling.rate))
    return scipy.ndimage.uniform_filter1d(force, width, axis=1)


def _friction(fit: Fit) -> float:
    """Coulomb friction (N) at no load, the scale against which missing forces count."""
    unknowns = fit.residuals.unpack(jnp.asarray(fit.search.y), fit.problem)[1]
    return 0.5 * float(unknowns.coulomb.positive + unknowns.coulomb.negative)


def _one_rate(logs: Sequence[Log]) -> float:
    if not logs:
        raise LogError("no log to identify from")
    for log in logs:
        if abs(log.rate / logs[0].rate - 1) > 1e-6:
            raise LogError(
                f"{log.name} is sampled at {log.rate:g} Hz, {logs[0].name} at {logs[0].rate:g} Hz: identify from logs of one rate"
            )
    return float(round(logs[0].rate, 6))


def _seeded(drive: Drive, logs: Sequence[Log]) -> tuple[Drive, list[str]]:
    """The drive with what inverse dynamics finds; as it is, with a note, where that finds nothing."""
    try:
        found = inverse_dynamics.identify(list(logs), DIRECTIONAL, min_speed=SLOWEST)
        seeded, notes = seed_drive(drive, found)
        check_drive(seeded)
    except DiffdriveError as problem:
        return drive, [f"inverse dynamics gave no start ({problem}); started from the drive file"]
    return seeded, list(notes)


SLOWEST = 1e-3  # m/s; below, the sign of the velocity says nothing about the direction of friction


def _held(fixed: Sequence[str]) -> set[str]:
    unknown = [name for name in fixed if name not in NAMES]
    if unknown:
        raise ParameterError(f"cannot fix '{unknown[0]}'; known: {', '.join(NAMES)}")
    return {NAMES[name] for name in fixed}


def _least_load(drive: Drive) -> float:
    """The smallest difference in load (N) that friction would show: a hundredth of the Coulomb friction."""
    friction = drive.friction
    slope = max(float(friction.load_coefficient.positive), 1e-6)
    return 0.01 * (float(friction.coulomb_screw.positive) / slope + float(friction.initial_load))


def _without(problem: Problem, held: set[str]) -> Problem:
    """Held parameters at the believed values; a held gap stays a gap, whatever becomes of the Coulomb friction."""
    before = problem.believed_unknowns
    values = {name: getattr(before, name) for name in held} | ({"breakaway": None} if "breakaway" in held else {})
    return problem._replace(unknowns=dataclasses.replace(problem.unknowns, **values))


def _value(unknowns: Unknowns, path: str) -> float:
    node = attrgetter(path)(unknowns)
    return float(node.positive if isinstance(node, Directional) else node)


def _space(
    problem: Problem, held: set[str], bounded: Mapping[str, tuple[float, float]]
) -> tuple[Problem, tuple[Free, ...]]:
    """What is free, within bounds about what was believed, and the problem with its starts inside them."""
    for name in bounded:
        if name not in NAMES:
            raise ParameterError(f"cannot bound '{name}'; known: {', '.join(NAMES)}")
    own = {NAMES[name]: limits for name, limits in bounded.items()}
    before, unknowns, free = problem.believed_unknowns, problem.unknowns, []
    for path in paths(unknowns):
        stem = path.split(".")[0]
        if stem in held:
            continue
        limits = bounds(path, _value(before, path), _value(before, "coulomb"))
        if stem in own:
            low, high = own[stem]
            if stem == "breakaway":  # given as a gap
                level = _value(before, path.replace("breakaway", "coulomb"))
                low, high = max(1e-2, 1 + low / level), 1 + high / level
            limits = limits._replace(low=low, high=high)
        reach = limits.high / limits.low if limits.low > 0 else np.nan
        edge = 1e-3 * (limits.high - limits.low) if np.isnan(reach) else 0.0
        inner = (
            (limits.low + edge, limits.high - edge)
            if np.isnan(reach)
            else (limits.low * reach**0.02, limits.high * reach**-0.02)
        )
        inside = float(np.clip(_value(unknowns, path), *inner))
        unknowns = _placed(unknowns, path, inside)
        free.append(limits)
    return problem._replace(unknowns=unknowns, origin=space_of(unknowns, free).origin), tuple(free)


def _placed(unknowns: Unknowns, path: str, value: float) -> Unknowns:
    node = attrgetter(path)(unknowns)
    new = Directional(value, value) if isinstance(node, Directional) else value
    return eqx.tree_at(attrgetter(path), unknowns, new)


def _scattered(
    coarse: Innovations, problem: Problem, starts: int, seed: int, progress: Progress
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " s"]]:
    """The best of several coarse searches; the first starts where the problem says, the others around it."""
    loose = np.array([free.path.split(".")[0] in SCATTERED for free in coarse.free])
    noise = np.random.default_rng(seed).normal(size=(starts - 1, len(loose))) * loose
    points = np.vstack([np.zeros(len(loose)), noise])
    found, costs = many_starts(coarse, points, as_arrays(problem), steps=COARSE_STEPS, progress=progress)
    return found[int(np.argmin(costs))], costs


@eqx.filter_jit
def _predict(fine: Innovations, y: Float[Array, " k"], problem: Problem) -> Predicted:
    return fine.predict(y, problem)


@eqx.filter_jit
def _linearised(fine: Innovations, y: Float[Array, " k"], problem: Problem) -> Any:
    def along(direction: Float[Array, " k"]) -> Any:
        return jax.jvp(lambda y: fine(y, problem), (y,), (direction,))

    return jax.vmap(along, out_axes=(None, 1))(jnp.eye(len(y)))


def _covariance(fine: Innovations, y: Float[np.ndarray, " k"], problem: Problem) -> Covariance:
    shape = problem.lanes.position.shape
    value, slope = (np.asarray(one) for one in _linearised(fine, jnp.asarray(y), as_arrays(problem)))
    samples = shape[0] * shape[1]
    return sandwich(value[:samples].reshape(shape), slope[:samples].reshape(*shape, -1), fine.sampling.rate)


def _undetermined(free: tuple[Free, ...], covariance: Covariance) -> set[str]:
    errors = np.sqrt(np.diag(covariance.matrix))
    return {one.path for one, error in zip(free, errors, strict=True) if error > UNDETERMINED}


def _narrowed(fit: Fit, lost: set[str]) -> tuple[Innovations, Float[np.ndarray, " k"], Problem]:
    """The problem without the parameters in `lost`, which go back to what was believed, and y of the others."""
    free, problem = fit.residuals.free, fit.problem
    kept = np.array([one.path not in lost for one in free])
    unknowns = problem.unknowns
    for path in sorted(lost):
        unknowns = _placed(unknowns, path, _value(problem.believed_unknowns, path))
    smaller = dataclasses.replace(fit.residuals, free=tuple(itertools.compress(free, kept)))
    return smaller, fit.search.y[kept], problem._replace(unknowns=unknowns, origin=np.asarray(problem.origin)[kept])


def _correlated(free: tuple[Free, ...], covariance: Covariance) -> list[tuple[str, str, float]]:
    found = []
    for a in range(len(free)):
        for b in range(a):
            if abs(covariance.correlation[a, b]) > INSEPARABLE:
                found.append((free[b].path, free[a].path, float(covariance.correlation[a, b])))
    return found


def _with_delay(drive: Drive, unknowns: Unknowns) -> Drive:
    """The drive with the delay found; one that is negative, a command logged late, as none."""
    delay = float(unknowns.delay)
    whole = int(max(0.0, delay))
    fraction = float(np.clip(delay - whole, 0.0, 1.0))
    return dataclasses.replace(
        drive, actuator=dataclasses.replace(drive.actuator, delay_samples=whole, delay_fraction=fraction or None)
    )
