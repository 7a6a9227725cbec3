"""Friction, mass and delay of a drive from its logs, by gradient.

    logs -> inverse dynamics (a start) -> many starts, coarse -> search and filter in turn -> intervals

A parameter that the logs do not determine is put back to what the drive file says, named, and the rest fitted again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.errors import ParameterError
from diffdrive.logs import Log
from diffdrive.model.parameters import Drive, check_drive, require_coulomb_friction
from diffdrive.model.quantity import Directional
from diffdrive.numerics.arrays import as_arrays, require_double_precision
from diffdrive.support.bounds import require_count
from diffdrive.support.resources import format_count, require_memory
from tuning.identification.adequacy import Adequacy, adequacy
from tuning.identification.encoder_choice import SIGNIFICANCE, permitted
from tuning.identification.estimates import ParameterEstimate, estimates
from tuning.identification.parameters import axis_path
from tuning.identification.problem import COARSE_SUBSTEP, FINE_SUBSTEP, IdentificationProblem, Innovations, sampling_of
from tuning.identification.refinement import (
    RefinedFit,
    coulomb_level,
    leading_innovation,
    missing_force,
    refine,
    refine_substeps,
    was_interrupted,
    without_undetermined,
)
from tuning.identification.rivals import RivalValue, rival_values
from tuning.identification.row_force import BetweenRows, loop_samples
from tuning.identification.setup import IdentificationSetup, build_problem
from tuning.identification.snapshots import as_rows_show, lacks_force, with_unknown_command
from tuning.identification.uncertainty import Covariance, repetition_inflation
from tuning.identification.unknowns import MULTIMODAL, Unknowns
from tuning.optimisation.least_squares import LeastSquaresResult, Outcome, StepProgress, multistart, no_progress
from tuning.optimisation.space import Coordinate, coordinates, near_bound
from tuning.store.store import Store, digest

COARSE_EVERY = 8  # samples; the many starts look at each n-th innovation
COARSE_STEPS = 8
DELAYS = 19  # that are tried before, over the range of the delay
UNDETERMINED = 0.25  # standard error in units of belief: the value is not known to a factor of two
MIN_DELAY = 0.01  # control periods, below which a delay is none
INSEPARABLE = 0.95  # correlation
TOO_NARROW = (
    "the table runs off under the command as it was logged, noise and all: the intervals do not hold what the command "
    "between the rows may have been"
)


@dataclass(frozen=True)
class Identification:
    """The drive as identified from logs, how sure each of its parameters is, and whether the model suffices."""

    drive: Drive
    estimates: list[ParameterEstimate]
    estimate_covariance: Float[np.ndarray, "q q"]  # their covariance, as wide as their intervals are
    adequacy: Adequacy
    covariance: Covariance
    correlated: list[tuple[str, str, float]]  # pairs, by their paths in an axis, that the logs hardly tell apart
    noise: float  # m, of the finer encoder
    scale_noise: float  # m
    process_force: float  # N, standard deviation of the force missing in the model, were it white
    innovation: Float[np.ndarray, "lanes n"]  # m, of the finer encoder
    missing_force: Float[np.ndarray, "lanes n"]  # N, force that the corrections stand for
    velocity: Float[np.ndarray, "lanes n"]  # m/s, as predicted
    search: LeastSquaresResult
    start_costs: Float[np.ndarray, " s"]  # cost of each start, over the best
    simulations: int  # of all logs, forward and with derivatives
    notes: tuple[str, ...]
    open_unknowns: frozenset[str]  # paths in the search space of what the logs do not determine
    full_fit: RefinedFit  # with every parameter free, before the undetermined ones were put back
    rival: tuple[RivalValue, ...] = ()  # what another start has elsewhere, though it explains the logs as well

    @property
    def between(self) -> BetweenRows:
        """What the command does between two rows of the logs: what is likelier."""
        return self.full_fit.residuals.between

    @property
    def loop_samples(self) -> int:
        """How many samples of its loop a row of the logs lasts: one where each of them is a row."""
        if self.between is BetweenRows.HELD:
            return 1
        return loop_samples(next(one.value for one in self.estimates if one.name == "delay"))

    @property
    def code(self) -> str:
        """What to make of it, for programs: ok, structure_remains, not_converged or interrupted."""
        if self.search.outcome is Outcome.CONVERGED and self.adequacy.has_structure:
            return "structure_remains"
        return _CODES[self.search.outcome]

    @property
    def status(self) -> str:
        """The same in words; never just "converged" over structured innovations."""
        return f"{self.search.status}; model incomplete" if self.code == "structure_remains" else self.search.status


_CODES = {Outcome.CONVERGED: "ok", Outcome.STOPPED: "not_converged", Outcome.INTERRUPTED: "interrupted"}


def identify(
    logs: Sequence[Log],
    drive: Drive,
    *,
    fixed: Sequence[str] = (),
    bounded: Mapping[str, tuple[float, float]] | None = None,
    starts: int = 6,
    seed: int = 0,
    store: Store | None = None,
    progress: StepProgress = no_progress,
    start: Unknowns | None = None,
    between: BetweenRows | None = None,
) -> Identification:
    """Identify `drive` from `logs` of one machine (all at one rate), starting from what it says.

    `fixed` names parameters (as in the drive file) that stay, `bounded` those with bounds of their own. Loads must be
    in the logs where they differ. The first search starts from inverse dynamics, or from `start`, the answer of an
    earlier fit with the same drive. Of logs with a motor encoder beside the scale both are fitted, unless a disturbance
    force remains then and the scale alone gives another answer. `between` is what the command is known to do between
    two rows; otherwise the logs show it, by their scale alone where both encoders leave a force. Finished searches are
    kept in the `store`, and taken from there when the identification is begun again. Raises `LogError` where a log
    cannot be used and `ParameterError` for unknown names.
    """
    require_search(starts, seed)
    require_double_precision()
    check_drive(drive)
    require_coulomb_friction(drive, "identification")
    setup = build_problem(logs, drive, fixed, bounded or {}, start)
    problem, free, rate = setup.problem, coordinates(setup.free), setup.rate
    coarse = Innovations(free, sampling_of(rate, COARSE_SUBSTEP), COARSE_EVERY)
    points, costs, stopped = _many_starts(coarse, problem, starts, seed, progress, store)
    theta = points[int(np.argmin(costs))]
    progress = _interrupt if stopped else progress
    held = refine(Innovations(free, sampling_of(rate, FINE_SUBSTEP)), theta, problem, setup.noise, progress, store)

    def finished(full_fit: RefinedFit) -> Identification:
        return _finished(full_fit, setup, points, costs, progress, store)

    def as_rows(between: BetweenRows | None) -> RefinedFit:
        return as_rows_show(held, problem, setup.noise, progress, store, between)

    if problem.lanes.motor is None or between is BetweenRows.SMOOTH or not lacks_force(held):
        return finished(held if between is BetweenRows.HELD else as_rows(between))
    bounds = {name: limits for name, limits in (bounded or {}).items() if name.rpartition(".")[2] != "compliance"}
    alone = identify(
        [log.replace(motor_position=None) for log in logs], drive,
        fixed=fixed, bounded=bounds, starts=starts, seed=seed, store=store, progress=progress, start=start,
        between=between,
    )  # fmt: skip
    if was_interrupted(alone.search):
        return finished(held._replace(search=held.search.interrupted()))
    found = finished(as_rows(BetweenRows.SMOOTH) if alone.between is BetweenRows.SMOOTH else held)
    if was_interrupted(found.search) or not found.adequacy.lacks_force:
        return found
    if permitted(found, alone) >= SIGNIFICANCE:
        # of a scale that leaves no force, what the rows are was not asked: the finer encoder may show it
        is_known = between is not None or alone.between is BetweenRows.SMOOTH or lacks_force(alone.full_fit)
        rows = held if is_known else as_rows(None)
        return found if rows.residuals.between is held.residuals.between else finished(rows)
    note = (
        f"the scale alone is fitted, and not the motor's encoder: with both a force of {found.adequacy.missing:.2g} N "
        f"RMS is missing, with the scale {alone.adequacy.missing:.2g} N, and its answer is another: the motor moves "
        "against the table as no rigid machine does; a diagnosis looks for what the screw between them does"
    )
    return replace(alone, notes=(note, *alone.notes))


def _finished(
    full_fit: RefinedFit,
    setup: IdentificationSetup,
    points: Float[np.ndarray, "s k"],
    costs: Float[np.ndarray, " s"],
    progress: StepProgress,
    store: Store | None,
) -> Identification:
    """The answer of a fit with every parameter free; `points` and `costs` are where the coarse searches ended."""
    problem, free, rate = setup.problem, coordinates(setup.free), setup.rate
    undetermined = _undetermined(full_fit)
    fit = full_fit
    if undetermined and not was_interrupted(full_fit.search):
        fit = refine(*without_undetermined(full_fit, undetermined), setup.noise, progress, store)
    rival: tuple[RivalValue, ...] = ()
    is_wide = True
    if not was_interrupted(fit.search):
        rival = rival_values(full_fit, points, costs, undetermined, progress)
        fit = _with_repetition(refine_substeps(fit, setup.noise, progress, store), rate)
        if full_fit.residuals.between is BetweenRows.SMOOTH:
            wide = [with_unknown_command(one, problem.lanes) for one in (fit, full_fit)]
            fit, full_fit = (one or narrow for one, narrow in zip(wide, (fit, full_fit), strict=True))
            is_wide = None not in wide
    drive_found, remark = _file_drive(fit)
    remark += () if is_wide else (TOO_NARROW,)
    missing = missing_force(fit)
    innovation, expected = leading_innovation(fit)
    longest = int(np.sum(fit.problem.lanes.counts, axis=1).max())  # the rest is padding
    table, scatter = estimates(
        fit.search.theta, fit.residuals, fit.problem, fit.covariance, undetermined | setup.unexcited
    )
    return Identification(
        drive=drive_found,
        estimates=table,
        estimate_covariance=scatter,
        adequacy=adequacy(
            innovation / expected,
            fit.deviance_gain,
            missing,
            coulomb_level(fit),
        ),
        covariance=fit.covariance,
        correlated=_correlated(fit.residuals.free, fit.covariance),
        noise=_finest_noise(setup),
        scale_noise=setup.scale_noise,
        process_force=fit.process_force,
        innovation=innovation[:, :longest],
        missing_force=missing[:, :longest],
        velocity=fit.velocity[:, :longest],
        search=fit.search,
        start_costs=costs / costs.min(),
        simulations=(COARSE_STEPS * len(points) + fit.steps) * (1 + len(free)) + DELAYS,
        notes=(*setup.notes, *remark),
        full_fit=full_fit,
        open_unknowns=frozenset(undetermined | setup.unexcited),
        rival=rival,
    )


def require_search(starts: int, seed: int) -> None:
    """Raise `ParameterError` for a number of starts, or a seed, that is none."""
    require_count("starts", starts)
    require_count("seed", seed, at_least=0)


def start_points(free: Sequence[Coordinate], starts: int, seed: int) -> Float[np.ndarray, "s k"]:
    """Points to search from: where the problem says, and about it in what the logs may leave several answers for."""
    require_memory(ParameterError, f"{format_count(starts)} starts", 8.0 * starts * len(free), "give fewer")
    is_multimodal = np.array([parameter.path.split(".")[0] in MULTIMODAL for parameter in free])
    noise = np.random.default_rng(seed).normal(size=(starts - 1, len(is_multimodal))) * is_multimodal
    return np.vstack([np.zeros(len(is_multimodal)), noise])


def _many_starts(
    coarse: Innovations,
    problem: IdentificationProblem,
    starts: int,
    seed: int,
    progress: StepProgress,
    store: Store | None,
) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, " s"], bool]:
    """Where several coarse searches ended, their costs, and whether they were interrupted.

    The first starts where the problem says, the others around it.
    """
    points = start_points(coarse.free, starts, seed)
    key = "" if store is None else digest("ends of starts", coarse, problem, points)
    stored = None if store is None else store.read(key)
    if stored is not None:
        return stored["points"], stored["costs"], False
    points[1:2] = _best_delay(coarse, problem)  # as an alternative: under a wrong model the best delay may be wrong
    points_found, costs, stopped = multistart(coarse, points, as_arrays(problem), steps=COARSE_STEPS, progress=progress)
    if store is not None and not stopped:
        store.write(key, {"points": points_found, "costs": costs})
    return points_found, costs, stopped


def _with_repetition(fit: RefinedFit, rate: float) -> RefinedFit:
    """The fit with the covariance of laps that are no new ones where residuals repeat from lap to lap."""
    innovation, expected = leading_innovation(fit)
    again = repetition_inflation(innovation / expected, rate)
    return fit._replace(covariance=fit.covariance._replace(matrix=again * fit.covariance.matrix))


def _finest_noise(setup: IdentificationSetup) -> float:
    motor = setup.problem.lanes.motor
    return setup.scale_noise if motor is None else min(setup.scale_noise, float(motor.noise[0]))


def _interrupt(*_: object) -> None:
    """A progress that ends a search with its first step, when the starts before it were interrupted."""
    raise KeyboardInterrupt


@eqx.filter_jit
def _costs(residuals: Innovations, points: Float[Array, "s k"], problem: IdentificationProblem) -> Float[Array, " s"]:
    return jax.vmap(lambda theta: jnp.linalg.norm(residuals(theta, problem)))(points)


def _best_delay(coarse: Innovations, problem: IdentificationProblem) -> Float[np.ndarray, " k"]:
    """The start moved to the best delay on the way from one of its bounds to the other.

    From a delay that is a sample off, friction first bends to make up for it, and seldom finds back.
    """
    points = np.zeros((1 + DELAYS, len(coarse.free)))
    for k, free in enumerate(coarse.free):
        if free.path == "delay":
            share = np.linspace(0.0, 1.0, DELAYS + 2)[1:-1]
            points[1:, k] = np.log(share / (1.0 - share)) - problem.origin[k]
    costs = np.asarray(_costs(coarse, jnp.asarray(points), as_arrays(problem)))
    return points[int(np.argmin(np.where(np.isfinite(costs), costs, np.inf)))]


def _undetermined(fit: RefinedFit) -> set[str]:
    """What the logs hardly narrow; not what they push against its bound, where the search vector has no more effect."""
    free, errors = fit.residuals.free, fit.problem.prior * np.sqrt(np.diag(fit.covariance.matrix))
    pushed = near_bound(free, fit.search.theta + fit.problem.origin)
    return {parameter.path for parameter, error in zip(free, errors, strict=True) if error > UNDETERMINED} - set(pushed)


def _correlated(free: tuple[Coordinate, ...], covariance: Covariance) -> list[tuple[str, str, float]]:
    found = []
    for a in range(len(free)):
        for b in range(a):
            if abs(covariance.correlation[a, b]) > INSEPARABLE:
                pair = axis_path(free[b].path), axis_path(free[a].path)
                found.append((*pair, float(covariance.correlation[a, b])))
    return found


def _file_drive(fit: RefinedFit) -> tuple[Drive, tuple[str, ...]]:
    """The drive found, as a drive file can say it, and what had to be bent for that."""
    drive, unknowns = jax.tree.map(float, fit.residuals.unpack(jnp.asarray(fit.search.theta), fit.problem))
    remarks = []
    delay = unknowns.delay
    if fit.residuals.between is BetweenRows.SMOOTH:
        remarks.append(
            "the rows seem to be snapshots of a loop that is faster than the log: the command is taken as smooth "
            f"between them, and acts {delay + 0.5:.2g} rows after a row's own instant"
        )
    elif delay < -MIN_DELAY:
        remarks.append(f"the command seems logged {-delay:.3g} samples late; the drive is written without a delay")
    delay = delay if delay > MIN_DELAY else 0.0
    samples = int(delay)
    fraction = delay - samples
    actuator = replace(drive.actuator, delay_samples=samples, delay_fraction=fraction or None)
    for side in ("positive", "negative"):
        damping, believed = (getattr(model.plant.damping, side) for model in (drive, fit.problem.believed))
        if damping < believed:
            remarks.append(
                f"damping.{side} lowered from {float(believed):.4g} to {damping:.4g} N s/m: the friction found grows "
                "less with speed than the file's damping alone"
            )
    friction = drive.friction
    if min(friction.coulomb_screw.positive, friction.coulomb_screw.negative) < 0:
        slope, level = friction.load_coefficient, unknowns.coulomb
        most = min(level.positive / slope.positive, level.negative / slope.negative)
        screw = Directional(level.positive - slope.positive * most, level.negative - slope.negative * most)
        screw = Directional(max(screw.positive, 0.0), max(screw.negative, 0.0))
        friction = replace(friction, coulomb_screw=screw, initial_load=most)
        remarks.append(
            f"initial_load lowered from {float(drive.friction.initial_load):.4g} to {most:.4g} N, since "
            "the friction found leaves no room for more"
        )
    return replace(drive, actuator=actuator, friction=friction), tuple(remarks)
