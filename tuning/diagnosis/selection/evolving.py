"""Where a fit of a coupled effect should begin: an evolution strategy on the stretches that tell most.

A motor behind a dead zone strikes the table a few times a second. A gap that is off by a twentieth mistimes every blow,
so that the cost is flat far from the truth and steep near it: no gradient leads there, nor does a coarse grid. A
population does, on seconds of the log in the place of all of it.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree
from scipy.stats import qmc

from diffdrive.effects.base import Effect
from diffdrive.effects.stages import Effects
from diffdrive.model.friction import coulomb
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from tuning.diagnosis.filter.effect_signals import EffectSignals
from tuning.diagnosis.filter.ekf import ProcessNoise, compiled_filter, deviance_of
from tuning.diagnosis.fits.fitted import Fitted
from tuning.diagnosis.gap.lines import missing_force
from tuning.diagnosis.hypotheses.model import Logged, Model, Vector, effect_in_lanes, machine, signals_along
from tuning.diagnosis.levels import WORTH
from tuning.identification.prediction import Lanes, initial_velocity
from tuning.optimisation.adaptation import Minimum, minimum
from tuning.store.store import Store, digest

STRETCHES, LENGTH, LEAD = 8, 0.4, 0.1  # how many, s that count, s before them in which the filter settles
REACH = 1.6  # standard deviations of the prior, to either side
SAMPLE, SIMULATIONS = 512, 1500  # points that fill the prior evenly, and those of the search from the best of them
WITHOUT = 64  # of lasting and process forces, where nothing is coupled: two numbers, as densely as the others
AT_ONCE = 12  # members that are filtered at once: more would not stay in cache
POPULATION = 2 * AT_ONCE  # of a generation: with half of it the search ends in the wrong one of neighbouring funnels
PUSH = 0.15  # of the friction, to either side: another effect's lasting force would pass for a wider or narrower gap
PROCESS = (1e-2, 1e2)  # N, lasting
PROCESSES = " processes"  # beside the names of parameters
WHITE = 3.0  # times that in a period: a blow that is a little early or late is forgiven


class Evolved(NamedTuple):
    """Where a fit should begin."""

    values: dict[str, Vector]
    processes: Float[np.ndarray, "w 2"]  # N


class Stretches(NamedTuple):
    """Pieces of the logs side by side, and what acts there."""

    lanes: Lanes
    under: EffectSignals


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


def cut(logged: Logged, under: EffectSignals, places: list[tuple[int, int]]) -> tuple[Stretches, tuple[int, ...]]:
    """The stretches that begin at `places`, each with its lead, and the log of each."""
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
    return Stretches(lanes, jax.tree.map(piece, under)), tuple(logged.owner[lane] for lane, _ in begins)


@eqx.filter_jit
def _deviances(
    drive: Drive,
    stretches: Stretches,
    coupled: Effects,
    push: Float[np.ndarray, " s"],
    process_noise: Float[np.ndarray, "s 2"],
    noise: Scalar,
    sampling: Sampling,
) -> Float[Array, " s"]:
    """Of members side by side, each over all stretches: a single batch, since each further one is traced anew."""
    members, pieces = len(push), len(stretches.lanes.position)

    def each(coupled: Effects, push: Scalar, process_noise: Float[Array, " 2"], stretch: Stretches) -> PyTree:
        under = stretch.under
        pushed = under._replace(force=under.force + push, beside=under.beside + push)
        lane, acts, effects = jax.tree.map(lambda leaf: leaf[None], (stretch.lanes, pushed, coupled))
        filtered = compiled_filter(drive, acts, effects, ProcessNoise(*process_noise), noise, lane, sampling)
        return filtered.innovation[0], filtered.innovation_std[0]

    of_each = jax.tree.map(lambda leaf: leaf.reshape(-1, *leaf.shape[2:]), coupled)
    along = jax.tree.map(lambda leaf: jnp.tile(leaf, (members, *[1] * (leaf.ndim - 1))), stretches)
    pushes, noises = (jnp.repeat(jnp.asarray(one), pieces, axis=0) for one in (push, process_noise))
    found = jax.vmap(each)(of_each, pushes, noises, along)
    innovation, scatter = (one.reshape(members, pieces, -1) for one in found)
    return jax.vmap(lambda one, std: deviance_of(one, std, stretches.lanes.counts)[0])(innovation, scatter)


def evolved_once(
    store: Store | None, fitted: Fitted, model: Model, index: int, theta: Vector, seed: int | None = None
) -> Evolved | None:
    """`evolved`, kept in the store or taken from there."""
    if store is None:
        return evolved(fitted, model, index, theta, seed)
    key = digest("evolved", fitted.model, fitted.theta, fitted.drive, fitted.filtered, model, index, theta, seed)
    kept = store.read(key)
    if kept is None:
        found = evolved(fitted, model, index, theta, seed)
        store.write(key, {} if found is None else found.values | {PROCESSES: found.processes})
        return found
    return Evolved(kept, kept.pop(PROCESSES)) if kept else None


def evolved(fitted: Fitted, model: Model, index: int, theta: Vector, seed: int | None = None) -> Evolved | None:
    """The likeliest parameters of a coupled member of `model`, and process forces; all else is at `theta`.

    `fitted` says where most is missing. With a `seed` the search begins at `theta`. Without, it begins at the best of a
    sample of all that is expected, and ends with None where it finds nothing likelier than without that member.
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
        return Evolved(values(first), forces(first))
    stretches, owner = cut(logged, signals_along(logged, own, loose, fitted.filtered.trajectory), places)

    usual = effect_in_lanes(candidate.effect, {}, owner)

    def in_stretches(shares: Float[np.ndarray, "s k"]) -> Effect:
        """The effect of every member over the stretches, as one whose numbers are arrays."""
        members = [values(share) for share in shares]
        known = {name: np.array([one[name][:1] for one in members]) for name in members[0]}
        fields = {field.name: known.get(field.name, getattr(usual, field.name)) for field in dataclasses.fields(usual)}
        size = len(shares), len(owner)
        return candidate.effect(**{name: np.broadcast_to(value, size) for name, value in fields.items()})

    lanes = np.array([logged.owner.index(k) for k in owner])
    beside = jax.tree.map(lambda one: np.broadcast_to(one[lanes], (AT_ONCE, len(lanes))), (*within,))

    def costs(shares: Float[np.ndarray, "s k"]) -> Float[np.ndarray, " s"]:
        return deviances(shares, lambda some: (in_stretches(some),))

    def deviances(
        shares: Float[np.ndarray, "s k"], added: Callable[[Float[np.ndarray, "s k"]], Effects]
    ) -> Float[np.ndarray, " s"]:
        filled = np.pad(shares, ((0, -len(shares) % AT_ONCE), (0, 0)), mode="edge")  # one program for any number
        found = [
            _deviances(
                drive, stretches, (*beside, *added(some)), PUSH * level * (2.0 * some[:, -2] - 1.0), forces(some),
                logged.noise, logged.sampling,
            )
            for some in np.split(filled, len(filled) // AT_ONCE)
        ]  # fmt: skip
        return np.concatenate(found)[: len(shares)]

    def searched(start: Float[np.ndarray, " k"], seed: int, target: float) -> Minimum:
        apart = SAMPLE ** (-1.0 / len(start))  # of the points of a sample, from one to the next
        return minimum(
            costs, start, 0.5 * apart,
            population=POPULATION, simulations=SIMULATIONS, tolerance=WORTH, target=target, seed=seed,
        )  # fmt: skip

    if seed is not None:
        share = searched(first, seed, np.inf).share
        return Evolved(values(share), forces(share))
    around = qmc.Sobol(2, seed=0).random(WITHOUT)
    without = float(np.nanmin(deviances(around, lambda _: ()), initial=np.inf))
    sample = np.vstack([first, qmc.Sobol(len(first), seed=0).random(SAMPLE)])
    found = searched(sample[int(np.argmin(np.nan_to_num(costs(sample), nan=np.inf)))], 0, without)
    return Evolved(values(found.share), forces(found.share)) if found.cost < without else None
