"""Where a fit of a coupled effect should begin: differential evolution on the stretches that tell most.

A motor behind a dead zone strikes the table a few times a second. A gap that is off by a twentieth mistimes every blow,
so that the cost is flat far from the truth and steep near it: no gradient leads there, nor does a coarse grid. A
population does, on seconds of the log in the place of all of it.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.effects.base import Effect
from diffdrive.effects.stages import Effects
from diffdrive.model.friction import coulomb
from diffdrive.model.parameters import Drive
from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.filter.ekf import ProcessNoise, deviance_of, run_filter
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.gap.lines import missing_force
from tuning.diagnosis.hypotheses.model import Logged, Model, Vector, effect_in_lanes, machine, signals_along, stacked
from tuning.identification.prediction import Lanes, initial_velocity
from tuning.optimisation.evolution import Budget, evolve
from tuning.store.store import Store, digest

STRETCHES, LENGTH, LEAD = 8, 0.4, 0.1  # how many, s that count, s before them in which the filter settles
REACH = 1.6  # standard deviations of the prior, to either side
SAMPLE, SIMULATIONS, POPULATION = 512, 3000, 6  # at first, in all; members per number searched
AT_ONCE = 12  # members that are filtered at once: more would not stay in cache
PUSH = 0.15  # of the friction, to either side: another effect's lasting force would pass for a wider or narrower gap
PROCESS = (1e-2, 1e2)  # N, lasting
PROCESSES = " processes"  # beside the names of parameters
WHITE = 3.0  # times that in a period: a blow that is a little early or late is forgiven


class Stretches(NamedTuple):
    """Pieces of the logs side by side, and what acts there."""

    lanes: Lanes
    under: EffectSignals
    owner: tuple[int, ...]


def telling(fitted: Fitted) -> list[tuple[int, int]]:
    """Lanes and first samples of the stretches in which most force is missing."""
    rate = fitted.model.logged.sampling.rate
    force = np.abs(missing_force(fitted))
    length = min(round(LENGTH * rate), force.shape[1] - 1)
    ahead = np.cumsum(np.pad(force, ((0, 0), (1, 0))), axis=1)
    total = ahead[:, length:] - ahead[:, :-length]
    found = []
    for _ in range(STRETCHES):
        lane, first = np.unravel_index(np.argmax(total), total.shape)
        if not total[lane, first] > 0:
            break
        found.append((int(lane), int(first)))
        total[lane, max(0, first - length) : first + length] = -1.0
    return found


def cut(logged: Logged, under: EffectSignals, places: list[tuple[int, int]]) -> Stretches:
    """The stretches that begin at `places`, each with its lead."""
    rate, n = logged.sampling.rate, logged.lanes.position.shape[1]
    lead = min(round(LEAD * rate), n // 4)
    length = min(round(LENGTH * rate) + lead, n)
    begins = [(lane, int(np.clip(first - lead, 0, n - length))) for lane, first in places]

    def piece(signal: Float[Array, "lanes n ..."]) -> Float[Array, "s m ..."]:
        values = np.asarray(signal)
        return jnp.asarray(np.stack([values[lane, first : first + length] for lane, first in begins]))

    signals = logged.lanes._replace(velocity=None)  # type: ignore[arg-type]  # None is no leaf: it has no samples to cut
    lanes = jax.tree.map(piece, signals)
    settled = jnp.asarray((np.arange(length) >= lead).astype(float))
    lanes = lanes._replace(counts=lanes.counts * settled, velocity=initial_velocity(lanes.position, rate))
    return Stretches(lanes, jax.tree.map(piece, under), tuple(logged.owner[lane] for lane, _ in begins))


@eqx.filter_jit
def _deviances(
    drive: Drive,
    stretches: Stretches,
    coupled: Effects,
    push: Float[np.ndarray, " s"],
    process_noise: Float[np.ndarray, "s 2"],
    logged: Logged,
) -> Float[Array, " s"]:
    def one(coupled: Effects, push: Float[Array, ""], process_noise: Float[Array, " 2"]) -> Float[Array, ""]:
        under = stretches.under
        pushed = under._replace(force=under.force + push, beside=under.beside + push)

        def each(*stretch: PyTree) -> tuple[Array, Array]:  # all side by side: short as they are, that is faster
            lanes, under, coupled = jax.tree.map(lambda leaf: leaf[None], stretch)
            filtered = run_filter(
                drive, under, coupled, ProcessNoise(*process_noise), logged.noise, lanes, logged.sampling
            )
            return filtered.innovation[0], filtered.innovation_std[0]

        innovation, scatter = jax.vmap(each)(stretches.lanes, pushed, coupled)
        return deviance_of(innovation, scatter, stretches.lanes.counts)[0]

    return lax.map(lambda each: one(*each), (coupled, push, process_noise), batch_size=AT_ONCE)


def evolved_once(
    store: Store | None, fitted: Fitted, model: Model, index: int, theta: Vector, seed: int | None = None
) -> tuple[dict[str, Vector], np.ndarray]:
    """`evolved`, kept in the store or taken from there."""
    if store is None:
        return evolved(fitted, model, index, theta, seed)
    key = digest("evolved", fitted.model, fitted.theta, fitted.drive, fitted.filtered, model, index, theta, seed)
    kept = store.read(key)
    if kept is None:
        values, processes = evolved(fitted, model, index, theta, seed)
        store.write(key, values | {PROCESSES: processes})
        return values, processes
    processes = kept.pop(PROCESSES)
    return kept, processes


def evolved(
    fitted: Fitted, model: Model, index: int, theta: Vector, seed: int | None = None
) -> tuple[dict[str, Vector], np.ndarray]:
    """The likeliest parameters of a coupled member of `model`, and process forces; all else is at `theta`.

    `fitted` says where most is missing. With a `seed` the search begins at `theta`, and in the middle without.
    """
    logged, candidate = model.logged, model.members[index].candidate
    others = dataclasses.replace(model, members=(*model.members[:index], *model.members[index + 1 :]))
    effects = others.effects(theta[~model.of_member(index)])
    loose, within = others.apart(effects)
    own, drive = machine(logged, jnp.asarray(model.calibration(theta)), effects)
    free, level = candidate.parameters, float(coulomb(drive.friction, 1.0, 0.0))

    def values(share: Float[np.ndarray, " k"]) -> dict[str, Vector]:
        found = {one.name: one.value(2 * REACH * (at - 0.5)) for one, at in zip(free, share, strict=False)}
        found |= {name: float(np.clip(found[name], low, high)) for name, low, high in candidate.bounds}
        return {name: np.full(logged.logs, value) for name, value in found.items()}

    def forces(shares: Float[np.ndarray, "*s k"]) -> Float[np.ndarray, "*s 2"]:
        return (PROCESS[0] * (PROCESS[1] / PROCESS[0]) ** shares[..., -1:]) * np.array([1.0, WHITE])

    first = np.full(len(free) + 2, 0.5)
    if seed is not None:
        there = [one.standard(float(model.values(theta)[index][one.name][0])) for one in free]
        first[: len(free)] = np.clip(0.5 + np.array(there) / (2 * REACH), 0.0, 1.0)
    places = telling(fitted)
    if not places:  # nothing is missing, or nobody can say where
        return values(first), forces(first)
    stretches = cut(logged, signals_along(logged, own, loose, fitted.filtered.trajectory), places)

    def in_stretches(share: Float[np.ndarray, " k"]) -> Effect:
        return effect_in_lanes(candidate.effect, values(share), stretches.owner)

    lanes = np.array([logged.owner.index(k) for k in stretches.owner])
    beside = within and jax.tree.map(lambda one: one[lanes], within)

    def costs(shares: Float[np.ndarray, "s k"]) -> Float[np.ndarray, " s"]:
        size = POPULATION * shares.shape[1]  # of a generation: one program for all, whatever their number
        filled = np.pad(shares, ((0, -len(shares) % size), (0, 0)), mode="edge")
        return np.concatenate([block(some) for some in np.split(filled, len(filled) // size)])[: len(shares)]

    def block(shares: Float[np.ndarray, "s k"]) -> Float[np.ndarray, " s"]:
        members = stacked([(*beside, in_stretches(share)) for share in shares])
        push = PUSH * level * (2.0 * shares[:, -2] - 1.0)
        return np.asarray(_deviances(drive, stretches, members, push, forces(shares), logged))

    budget = Budget(SIMULATIONS, np.inf, -np.inf)
    screened = SAMPLE if seed is None else 0
    found = evolve(costs, first, budget, population=POPULATION, screened=screened, seed=seed or 0)
    return values(found.share), forces(found.share)
