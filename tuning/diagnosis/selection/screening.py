"""The whole catalogue against what a hypothesis leaves: how much would each effect explain?

To first order, an effect bends the innovations along its answers to a small amount of it. What of the innovations lies
along these, once the parameters that are free already have taken their part, is what the effect would explain: one
projection for each point of its grid, no fit (Rao's score test).
"""

import dataclasses
import operator
from collections.abc import Callable, Iterable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.effects.base import MachineEffect
from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.fits.curvature import limited, log_volume, solved
from tuning.diagnosis.fits.differences import by_acts
from tuning.diagnosis.fits.fitted import Fitted, Point, of_residuals, residual_jvp
from tuning.diagnosis.fits.fitting import Fitter
from tuning.diagnosis.fits.goodness_of_fit import max_prior_deviation
from tuning.diagnosis.fits.reduced import reduced
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.candidate import Candidate
from tuning.diagnosis.hypotheses.model import (
    Logged,
    Member,
    Model,
    Vector,
    effect_in_lanes,
    parameter_jacobian,
    signals_along,
    signals_jvp,
    stacked,
)
from tuning.diagnosis.hypotheses.priors import Parameter
from tuning.diagnosis.levels import STRAINED
from tuning.diagnosis.selection.evolving import evolved_once
from tuning.diagnosis.selection.starting_points import starting_points
from tuning.store.store import Arrays

TRIED = np.array([(1, 1), (0.3, 0.3), (0.1, 0.1), (0.01, 0.01), (3, 3), (0.03, 1), (0.3, 3)])  # times process forces
BEST = 3  # of a grid, at which more is done than to screen it
LIKELY, BETWEEN = 2, 8  # points of a grid about which it is refined, and how many are tried there
LITTLE, MUCH = 0.1, 2.0  # of a point of a grid: the least and the most that a secant takes of it
GLANCE = 2  # steps of a fit, by which what had made up for an effect makes way for it
SCREENED = ("gain", "evidence", "rest", "aside", "processes")  # in the order of `Screened`
VALUE = "value "  # before the name of a parameter
DEARNESS = 7.0  # of evidence, that a parameter costs which the log tells to a thirtieth of its prior's spread


Values = dict[str, Vector]


class Screened(NamedTuple):
    """What one candidate would explain."""

    candidate: Candidate
    gain: float  # fall of the cost
    evidence: float  # and of -2 log evidence
    values: dict[str, Vector]  # of its parameters, one for each log: where to start a fit
    rest: Vector  # theta of what was free before, after its own step and the effect's
    aside: Vector  # after the effect's alone
    processes: Float[np.ndarray, "k 2"]  # N: the process forces to start from


def written_screened(found: Screened) -> Arrays:
    """As a `Store` keeps it."""
    fields = {name: np.asarray(getattr(found, name)) for name in SCREENED}
    return fields | {f"{VALUE}{name}": np.asarray(value) for name, value in found.values.items()}


def read_screened(candidate: Candidate, piece: Arrays) -> Screened:
    """What `written_screened` was given."""
    values = {name.removeprefix(VALUE): value for name, value in piece.items() if name.startswith(VALUE)}
    gain, evidence, *others = (piece[name] for name in SCREENED)
    return Screened(candidate, float(gain), float(evidence), values, *others)


Labels = list[tuple[Parameter, int | None]]


def sensitivities(fitted: Fitted, candidate: Candidate, point: Values) -> tuple[Float[np.ndarray, "m k"], Labels]:
    """Derivatives of the residuals by each amplitude of the candidate at a point of its grid, and what each is of: a
    parameter, in units of its prior, and of which log; zero where the filter was lost.

    The candidate acts alone; the effects outside the filter that are there enter as a known force beside the motor's.
    To first order this is exact, but for their interaction in the actuator.
    """
    columns, bend, labels = _small_changes(fitted, candidate, point)
    alone = residual_jvp(fitted, bend, columns)
    if not fitted.model.coupled:
        return alone, labels
    found = by_acts(
        fitted.model, fitted.theta, fitted.process_noise, fitted.filtered, fitted.drive, fitted.signals,
        np.asarray(columns), bend, alone,
    )  # fmt: skip
    return of_residuals(fitted, found), labels


def _without_answers(fitted: Fitted, candidate: Candidate, point: Values) -> tuple[Float[np.ndarray, "m k"], Labels]:
    """`sensitivities` by the linear recursion alone, without the effects within the filter; zero where it runs away."""
    columns, bend, labels = _small_changes(fitted, candidate, point)
    return np.nan_to_num(residual_jvp(fitted, bend, columns), posinf=0.0, neginf=0.0), labels


def _small_changes(
    fitted: Fitted, candidate: Candidate, point: Values
) -> tuple[Float[Array, "p m"], EffectSignals, list[tuple[Parameter, int | None]]]:
    """Of the machine's numbers and of what acts, by each amplitude."""
    logged = _pushed(fitted)
    effect = effect_in_lanes(candidate.effect, point, logged.owner)
    amplitudes = [one for one in candidate.parameters if one.amplitude]
    trajectory = fitted.filtered.trajectory
    labels = [(one, log) for one in amplitudes for log in (range(logged.logs) if one.session else [None])]
    rows = []
    for one, log in labels:
        here = np.array([log is None or log == owner for owner in logged.owner], float) * one.spread
        zero = jax.tree.map(np.zeros_like, effect)
        rows.append(eqx.tree_at(operator.attrgetter(one.name), zero, here))
    tangents = stacked(rows)
    bend = signals_jvp(logged, fitted.drive, (effect,), (tangents,), trajectory)
    columns = jnp.zeros((fitted.step_jacobians.machine.shape[-1], len(rows)))
    if issubclass(candidate.effect, MachineEffect):
        b = jnp.asarray(fitted.model.calibration(fitted.theta))
        others = fitted.model.apart(fitted.model.effects(fitted.theta))[0]
        still = jax.tree.map(lambda leaf: np.zeros((len(rows), *leaf.shape)), others)
        columns = parameter_jacobian(logged, b, (*others, effect), (*still, tangents))[:, len(NAMES) :]
    return columns, bend, labels


def _pushed(fitted: Fitted) -> Logged:
    """The logs, the force of the effects outside the filter added to what is known to act."""
    logged = fitted.model.logged
    without = signals_along(logged, fitted.drive, (), fitted.filtered.trajectory)
    known = logged.lanes.disturbance + (fitted.signals.force - without.force)
    return logged._replace(lanes=logged.lanes._replace(disturbance=known))


def screen(fitted: Fitted, candidate: Candidate) -> Screened:
    """The best point of the grid of a candidate with amplitudes; of no evidence where there is none.

    Beside effects within the filter, whose differences cost much, the best are told by the linear recursion first.
    """
    first = _without_answers if fitted.model.coupled else sensitivities

    def at(points: Iterable[Values]) -> list[tuple[Screened, Values]]:
        return [(_screened(fitted, candidate, point, first), point) for point in points]

    def likelier(one: tuple[Screened, Values]) -> float:
        return -one[0].evidence

    found = sorted(at(starting_points(fitted, candidate)), key=likelier)
    if candidate.narrow:
        found += at(point for one, _ in found[:LIKELY] for point in _about(candidate, one))
        found.sort(key=likelier)
    best = [one for one, _ in found[:BEST]]
    if fitted.model.coupled:
        best = [_screened(fitted, candidate, point, sensitivities) for _, point in found[:BEST]]
    nothing = Screened(candidate, 0.0, -np.inf, {}, fitted.theta, fitted.theta, fitted.process_noise * TRIED)
    return max(best, key=lambda one: one.evidence, default=nothing)


def _about(candidate: Candidate, found: Screened) -> list[Values]:
    """Points between a point of the grid and its neighbours."""
    steps = np.array([point[candidate.narrow] for point in candidate.grid])
    step = float(np.log(steps[1] / steps[0])) if len(steps) > 1 else 0.0
    fixed = {name: found.values[name] for name in candidate.grid[0]}
    shares = step * np.linspace(-1, 1, BETWEEN + 2)[1:-1]
    return [fixed | {candidate.narrow: fixed[candidate.narrow] * np.exp(share)} for share in shares]


def _screened(
    fitted: Fitted,
    candidate: Candidate,
    point: Values,
    derivatives: Callable[[Fitted, Candidate, Values], tuple[Float[np.ndarray, "m k"], Labels]],
) -> Screened:
    """What the candidate would explain at a point of its grid, by these derivatives of the residuals."""
    logged, values = fitted.model.logged, dict(point)
    d, labels = derivatives(fitted, candidate, values)
    schur, slope, left, making_way = reduced(fitted, d)
    schur = schur + np.eye(len(schur))
    amount = -solved(schur, slope)
    gain = float(-slope @ amount)
    evidence = gain - log_volume(schur)
    evidence = evidence if np.isfinite(evidence) else -np.inf  # an amount that no filter survives explains nothing
    for (one, log), value in zip(labels, amount, strict=True):
        row = values.setdefault(one.name, np.zeros(logged.logs))
        row[slice(None) if log is None else log] = value * one.spread
    rest, aside = (fitted.theta - limited(way + making_way @ amount) for way in (left, 0.0 * left))
    return Screened(candidate, gain, evidence, values, rest, aside, fitted.process_noise * TRIED)


def tried(fitter: Fitter, fitted: Fitted, candidate: Candidate) -> Screened | None:
    """The best point of the grid of a candidate that is not there by degrees, or the best that a search finds; None
    where that finds none that is likelier than nothing.

    About the nominal parameters too, as long as recalibration may have gone astray to make up for what is missing; and
    with what is free already moved to make way: what recalibration has made up for is worse with the effect at first.
    """
    model = joined(fitted.model, candidate)
    may_be_off = not fitted.model.added or max_prior_deviation(fitted) >= STRAINED
    before = np.where(may_be_off & (np.arange(fitted.theta.size) < len(NAMES)), 0.0, fitted.theta)
    points, processes = starting_points(fitted, candidate), fitted.process_noise * TRIED
    if candidate.searched:
        last = len(model.members) - 1
        evolved = evolved_once(fitter.store, fitted, model, last, np.r_[before, begin(model, {})])
        if evolved is None:
            return None
        points, processes = [evolved.values], np.vstack([processes, evolved.processes])

    def tried_from(calibration: Vector, values: Values) -> tuple[Point, Values]:
        theta = np.r_[calibration, begin(model, values)]
        return fitter.at(model, theta, fitted.process_noise, fitted.filtered.trajectory), values

    found = [tried_from(fitted.theta, values) for values in points]
    if not model.coupled:
        cheapest = sorted(found, key=lambda one: one[0].cost)[:BEST]  # not all lie where a fit finds down
        found += [_made_way(fitter, fitted, model, one) for one in cheapest]
    if may_be_off:
        found += [tried_from(before, values) for values in points]
    found.sort(key=lambda one: one[0].cost)
    likely = [(fitter.with_process(one, model, processes), values) for one, values in found[:BEST]]
    there, values = min(likely, key=lambda one: one[0].cost)
    gain, rest = fitted.cost - there.cost, there.theta[: fitted.theta.size]
    return Screened(candidate, gain, gain - DEARNESS * len(candidate.parameters), values, rest, rest, processes)


def _made_way(fitter: Fitter, fitted: Fitted, model: Model, at: tuple[Point, Values]) -> tuple[Point, Values]:
    """The effect, and what was free before moved to make way for it, after two steps of a fit.

    They begin where the first order points, along the secant to what the effect does `at` a point where all else is as
    fitted: at its values there or, of a single parameter, at the amount that explains most.
    """
    point, values = at
    secant = np.where(fitted.residual != 0.0, fitter.residuals(point)[0] - fitted.residual, 0.0)
    found = reduced(fitted, secant[:, None])
    curvature, slope = float(found.curvature[0, 0]), float(found.slope[0])
    amounts = {1.0}
    if len(values) == 1 and curvature > 0.0 and np.isfinite(slope):
        amounts.add(float(np.clip(-slope / curvature, LITTLE, MUCH)))
    begun = []
    for amount in sorted(amounts):
        scaled = {name: amount * value for name, value in values.items()}
        theta = np.r_[fitted.theta - limited(found.wanted + amount * found.way[:, 0]), begin(model, scaled)]
        begun.append(fitter.at(model, theta, fitted.process_noise, fitted.filtered.trajectory))
    best = min(begun, key=lambda one: one.cost)
    there, _ = fitter.minimise(model, best.theta, best.process_noise, best.trajectory, GLANCE)
    return there, model.values(there.theta)[-1]


def joined(model: Model, candidate: Candidate, values: dict[str, Vector] | None = None) -> Model:
    """The model with one more effect; what the candidate leaves alone stays at `values`."""
    free = {one.name for one in candidate.parameters}
    fixed = tuple((name, float(value[0])) for name, value in (values or {}).items() if name not in free)
    return dataclasses.replace(model, members=(*model.members, Member(candidate, fixed)))


def begin(model: Model, values: dict[str, Vector], member: int = -1) -> Vector:
    """Theta of a member of a model, the last one if none is given, at `values`; at its middle where there is none."""
    wanted = member % len(model.members)
    known = {one.name: one for one in model.members[wanted].candidate.parameters}
    theta = []
    for index, name, log in model.slots:
        if index == wanted:
            given = values.get(name)
            theta.append(0.0 if given is None else known[name].standard(float(given[0 if log is None else log])))
    return np.array(theta)
