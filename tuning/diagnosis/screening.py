"""The whole catalogue against what a hypothesis leaves: how much would each effect explain?

To first order, an effect bends the innovations along its answers to a small amount of it. What of the innovations lies
along these, once the parameters that are free already have taken their part, is what the effect would explain: one
projection for each point of its grid, no fit (Rao's score test).
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.effects.acting import Effects
from diffdrive.effects.base import Effect, MachineEffect
from diffdrive.parameters import Drive
from tuning.diagnosis.calibration import NAMES
from tuning.diagnosis.candidates import Candidate
from tuning.diagnosis.fitting import LEAST, MOST, Fitted, Fitter, passes
from tuning.diagnosis.following import Course, Process, answers, exposure, follow
from tuning.diagnosis.lines import looked_for
from tuning.diagnosis.model import (
    Logged,
    Member,
    Model,
    Vector,
    effect_in_lanes,
    exposed,
    exposure_slopes,
    machine,
    machine_slopes,
)

TRIED = np.array([(1, 1), (0.3, 0.3), (0.1, 0.1), (0.01, 0.01), (3, 3)])  # times the process forces
REFINED, FEW_STEPS = 2, 5
AT_ONCE = 16  # points of a grid


class Screened(NamedTuple):
    """What one candidate would explain."""

    candidate: Candidate
    gain: float  # fall of the cost
    evidence: float  # and of -2 log evidence
    values: dict[str, Vector]  # of its parameters, one for each log: where to start a fit
    fitted: Fitted | None = None  # where a fit has begun already


@eqx.filter_jit
def _responses(fitted_track: Any, linear: Any, forcing: Any, off: Any, counts: Any, period: float) -> Any:
    return answers(fitted_track, linear, forcing, off, period) * counts[..., None]


def respond(fitted: Fitted, bend: Any, columns: Float[Array, "p m"] | None) -> Float[np.ndarray, "lanes n m"]:
    """Answers of the residuals to changed exposures ([lanes, n, m]) and numbers of the machine ([p, m])."""
    acts = jnp.stack([bend.force, bend.coulomb, bend.gap, bend.viscous], axis=-2)
    forcing = jnp.einsum("lnrc,lncm->lnrm", fitted.linear.exposure, acts)
    if columns is not None:
        forcing = forcing + jnp.einsum("lnrp,pm->lnrm", fitted.linear.machine, columns)
    logged = fitted.model.logged
    counts, period = logged.lanes.counts, logged.sampling.period
    return np.asarray(_responses(fitted.track, fitted.linear, forcing, bend.scale, counts, period)) / np.sqrt(
        float(fitted.track.size)
    )


def _directions(fitted: Fitted, candidate: Candidate, point: dict[str, Vector]) -> tuple[np.ndarray, list[Any]]:
    """Answers to each amplitude of the candidate at a point of its grid ([m, lanes, n]), and what each is of."""
    logged = fitted.model.logged
    others = fitted.model.effects(fitted.u)
    effect = effect_in_lanes(candidate.effect, point, logged.owner)
    amplitudes = [one for one in candidate.parameters if one.amplitude]
    course = fitted.track.course
    if not amplitudes:
        with_it = exposed(logged, fitted.own, (*others, effect), course)
        bend = jax.tree.map(lambda a, b: (a - b)[..., None], with_it, fitted.acting)
        return respond(fitted, bend, None), [None]
    labels = [(one, log) for one in amplitudes for log in (range(logged.logs) if one.session else [None])]
    rows = []
    for one, log in labels:
        here = np.array([log is None or log == owner for owner in logged.owner], float) * one.spread
        zero = jax.tree.map(jnp.zeros_like, (*others, effect))
        rows.append(eqx.tree_at(lambda tree, n=one.name: getattr(tree[-1], n), zero, jnp.asarray(here)))
    tangents = jax.tree.map(lambda *leaves: jnp.stack(leaves), *rows)
    bend = exposure_slopes(logged, fitted.own, (*others, effect), tangents, course)
    columns = None
    if issubclass(candidate.effect, MachineEffect):
        b = jnp.asarray(fitted.model.tolerance * fitted.u[: len(NAMES)])
        columns = machine_slopes(logged, b, (*others, effect), tangents)[:, len(NAMES) :]
    return respond(fitted, bend, columns), labels


def screen(fitted: Fitted, candidate: Candidate) -> Screened:
    """The best point of the candidate's grid."""
    logged = fitted.model.logged
    samples = fitted.residual.size
    left = np.linalg.solve(fitted.hessian, fitted.jacobian.T @ fitted.residual + fitted.u)
    best: Screened | None = None
    for point in looked_for(fitted, candidate):
        values = dict(point)
        found, labels = _directions(fitted, candidate, values)
        d = np.where(fitted.residual[:, None] != 0.0, found.reshape(samples, -1), 0.0)  # not where the filter was lost
        cross = fitted.jacobian.T @ d
        schur = d.T @ d - cross.T @ np.linalg.solve(fitted.hessian, cross)
        slope = d.T @ fitted.residual - cross.T @ left
        prior = np.eye(len(schur)) if labels[0] is not None else np.zeros((1, 1)) + 1e-9
        schur = schur + prior
        amount = -np.linalg.solve(schur, slope)
        gain = float(-slope @ amount)
        if labels[0] is None:  # an effect of this size and no other
            amount = np.clip(amount, 0.0, 1.5)
            gain = float(-2.0 * slope @ amount - amount @ schur @ amount)
        evidence = gain - float(np.linalg.slogdet(schur)[1]) if labels[0] is not None else gain
        if best is None or evidence > best.evidence:
            for (one, log), value in zip([x for x in labels if x is not None], amount, strict=False):
                row = values.setdefault(one.name, np.zeros(logged.logs))
                row[slice(None) if log is None else log] = value * one.spread
            best = Screened(candidate, gain, evidence, values)
    assert best is not None
    return best


class _Tried(NamedTuple):
    """Deviances of one point of a grid under each process force, and the course under the last but one filter."""

    deviance: Float[Array, " q"]
    course: Course


@eqx.filter_jit
def _over(
    logged: Logged, own: Drive, drive: Drive, others: Effects, grid: Effect, course: Course, processes: Any, turns: int
) -> _Tried:
    """Every point of a grid, `grid` being stacked: all in one program, since its lanes fill the processor's vectors."""

    def one(effect: Effect) -> _Tried:
        seen = course
        for _ in range(turns - 1):
            under = exposure(own, (*others, effect), logged.delay, logged.lanes, seen, logged.sampling)
            track = follow(drive, under, Process(*processes[0]), logged.noise, logged.lanes, logged.sampling)
            seen = jax.tree.map(lambda a, b: 0.5 * (a + b), seen, track.course)
        under = exposure(own, (*others, effect), logged.delay, logged.lanes, seen, logged.sampling)

        def likely(process: Any) -> Any:
            return follow(drive, under, Process(*process), logged.noise, logged.lanes, logged.sampling).deviance

        return _Tried(jax.vmap(likely)(processes), seen)

    return jax.vmap(one)(grid)


def tried(fitter: Fitter, fitted: Fitted, candidate: Candidate) -> Screened:
    """The best point of the grid of a candidate that is not there by degrees, each filtered in full.

    The best are fitted a little, from the nominal parameters: recalibration may have gone astray to make up for what is
    missing.
    """
    logged, model = fitter.logged, joined(fitted.model, candidate)
    first = not fitted.model.members
    before = np.where(first & (np.arange(fitted.u.size) < len(NAMES)), 0.0, fitted.u)
    others = fitted.model.effects(before)
    own, drive = machine(logged, jnp.asarray(model.tolerance * before[: len(NAMES)]), others)
    points = looked_for(fitted, candidate)
    processes = np.unique(np.clip(fitted.process * TRIED, LEAST, MOST), axis=0)[::-1]
    found = []
    for few in (points[k : k + AT_ONCE] for k in range(0, len(points), AT_ONCE)):
        filled = [*few, *[few[-1]] * (AT_ONCE - len(few) if len(points) > AT_ONCE else 0)]
        effects = [effect_in_lanes(candidate.effect, point, logged.owner) for point in filled]
        grid = jax.tree.map(lambda *leaves: jnp.stack(leaves), *effects)
        turns = passes(model)
        there = _over(logged, own, drive, others, grid, fitted.track.course, jnp.asarray(processes), turns)
        deviances = np.nan_to_num(np.asarray(there.deviance), nan=np.inf)
        for k, point in enumerate(few):
            best = int(np.argmin(deviances[k]))
            course = jax.tree.map(lambda one, k=k: one[k], there.course)
            found.append((float(deviances[k, best]), len(found), point, processes[best], course))
    fits = [
        fitter.fit(model, np.r_[before, begin(model, point)], process, course, most=FEW_STEPS)
        for _, _, point, process, course in sorted(found, key=lambda one: one[:2])[:REFINED]
    ]
    best_fit = min(fits, key=lambda one: one.cost)
    gain, evidence = fitted.cost - best_fit.cost, fitted.evidence - best_fit.evidence
    return Screened(candidate, gain, evidence, model.values(best_fit.u)[-1], best_fit)


def joined(model: Model, candidate: Candidate, values: dict[str, Vector] | None = None) -> Model:
    """The model with one more effect; what the candidate leaves alone stays at `values`."""
    free = {one.name for one in candidate.parameters}
    fixed = tuple((name, float(value[0])) for name, value in (values or {}).items() if name not in free)
    return Model(model.logged, (*model.members, Member(candidate, fixed)), model.tolerance)


def begin(model: Model, values: dict[str, Vector]) -> Vector:
    """U of the last member of a model at `values`; at its middle where none is given."""
    last = len(model.members) - 1
    known = {one.name: one for one in model.members[last].candidate.parameters}
    u = []
    for index, name, log in model.slots:
        if index == last:
            given = values.get(name)
            u.append(0.0 if given is None else known[name].standard(float(given[0 if log is None else log])))
    return np.array(u)
