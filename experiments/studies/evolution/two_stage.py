"""The paper's route to a friction model, as a baseline: sliding parameters first, then the bristle (paper, Sec. 4.1).

    cruises -> Stribeck curve -> F_C, F_S, v_s, mu_v per direction, by least squares
    reversals -> friction over the distance since -> sigma_0, sigma_1, by a genetic algorithm

Mass and, where it is identifiable, offset come from inverse dynamics. Each stage uses a part of the log only, and
friction only through the filter that makes an acceleration of a position: what happens within a / (2 f^2) of a reversal
is blurred. It needs cruises at four speeds or more each way, and knows no delay.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive.logs import Log
from diffdrive.model.friction import steady_friction
from diffdrive.model.parameters import Drive, check_drive
from diffdrive.numerics.arrays import as_arrays, require_double_precision
from tuning.identification import inverse_dynamics
from tuning.identification.curves import stribeck_curves
from tuning.identification.friction_along import friction_along
from tuning.identification.inverse_dynamics import DYNAMICS, MIN_SPEED
from tuning.identification.measured_friction import MeasuredFriction, measured_friction, passes
from tuning.identification.regressors import DIRECTIONAL
from tuning.identification.seed import initial_drive
from tuning.identification.unknowns import Unknowns, default_bounds, free_paths, unknowns_of
from tuning.optimisation.evolution import BLOCK, Budget, Evolution, Population, evolve, origin_fractions, theta_at
from tuning.optimisation.least_squares import levenberg_marquardt
from tuning.optimisation.space import FreeParameter, SearchSpace, search_space

SLIDING_PARAMETERS = ("coulomb", "breakaway", "stribeck_velocity", "viscous")
MIN_SPEEDS = 4  # each way, for four parameters
REACH = 20.0  # nominal bristle lengths F_S / sigma_0 behind a reversal: as far as the hysteresis is looked at
BUDGET = Budget(simulations=4_000, seconds=60.0)
POPULATION = 15  # members per parameter: of so few parameters, scipy's default does


@dataclass(frozen=True)
class TwoStage:
    """The drive that the two stages find, the misfit of each stage, and notes."""

    drive: Drive
    stribeck_rms: float  # N, over the bins of the Stribeck curve
    hysteresis_rms: float  # N, over the samples behind reversals
    evolution: Evolution
    notes: tuple[str, ...]


class _CruiseData(NamedTuple):
    """The Stribeck curve, and the drive whose friction is to pass through it."""

    nominal: Drive
    unknowns: Unknowns
    origin: Float[Array, " free"] | Float[np.ndarray, " free"]
    velocity: Float[Array, " b"]  # m/s
    load: Float[Array, " b"]  # N
    friction: Float[Array, " b"]  # N, damping included


class _ReversalData(NamedTuple):
    """A measured motion and the friction along it."""

    velocity: Float[Array, " n"]  # m/s
    load: Float[Array, " n"]  # N
    friction: Float[Array, " n"]  # N, damping included
    counts: Float[Array, " n"]  # 1 close behind a reversal
    period: float  # s


@dataclass(frozen=True)
class _StribeckResiduals:
    """Residuals (N) of the Stribeck curve as a function of theta; hashed by value."""

    free: tuple[FreeParameter, ...]

    def __call__(self, theta: Float[Array, " k"], points: _CruiseData) -> Float[Array, " b"]:
        drive = SearchSpace(self.free, points.origin).insert(points.unknowns, theta).drive(points.nominal)
        steady = steady_friction(drive.friction, points.velocity, points.load)
        return steady + drive.plant.damping.towards(points.velocity) * points.velocity - points.friction


def two_stage(
    logs: Sequence[Log], drive: Drive, *, dynamics: float = DYNAMICS, budget: Budget = BUDGET, seed: int = 0
) -> TwoStage:
    """Identify mass and friction of `drive` from `logs` by the paper's route.

    `dynamics` (Hz) sets the filters, as in `tuning.identification.inverse_dynamics`. A direction with fewer than four
    speeds of cruising keeps the friction of inverse dynamics, and a note says so. Raises `LogError` where the logs have
    no stretch that can be filtered.
    """
    require_double_precision()
    check_drive(drive)
    dynamics_fit = inverse_dynamics.identify(list(logs), DIRECTIONAL, dynamics=dynamics, min_speed=MIN_SPEED)
    seeded, notes = initial_drive(drive, dynamics_fit)
    sliding, stribeck_rms, curve_notes = _fit_sliding(logs, seeded, dynamics)
    fitted, evolution = _fit_bristle(logs, sliding, dynamics, budget, seed)
    return TwoStage(
        jax.tree.map(float, fitted),
        stribeck_rms,
        evolution.cost,
        evolution,
        (*notes, *curve_notes, f"bristle: {evolution.status}"),
    )


def _fit_sliding(logs: Sequence[Log], drive: Drive, dynamics: float) -> tuple[Drive, float, list[str]]:
    """`drive` with the sliding friction of the logs' cruises, and the RMS misfit (N)."""
    curves = stribeck_curves(list(logs), drive, dynamics=dynamics)
    rows = [np.stack([c.velocity, np.full_like(c.velocity, c.load), c.friction]) for c in curves.curves]
    velocity, load, friction = np.concatenate(rows, axis=1) if rows else np.zeros((3, 0))
    notes, free = list(curves.notes), []
    unknowns = unknowns_of(drive, 0.0)
    for side, sign in (("positive", 1.0), ("negative", -1.0)):
        speeds = int(np.sum(sign * velocity > 0))
        if speeds < MIN_SPEEDS:
            notes.append(f"{speeds} speeds of cruising in the {side} direction: its Stribeck curve is left as it was")
            continue
        for name in SLIDING_PARAMETERS:
            path = f"{name}.{side}"
            value = float(getattr(getattr(unknowns, name), side))
            free.append(default_bounds(path, value, float(getattr(unknowns.coulomb, side))))
    if not free:
        return drive, float("nan"), notes
    cruises = (jnp.asarray(signal) for signal in (velocity, load, friction))
    points = as_arrays(_CruiseData(drive, unknowns, search_space(unknowns, free).origin, *cruises))
    search = levenberg_marquardt(
        _StribeckResiduals(tuple(free)), np.zeros(len(free)), points, max_steps=200, tolerance=1e-8
    )
    fitted = SearchSpace(tuple(free), points.origin).insert(unknowns, search.theta).drive(drive)
    return fitted, search.cost / np.sqrt(len(velocity)), notes


def _fit_bristle(
    logs: Sequence[Log], drive: Drive, dynamics: float, budget: Budget, seed: int
) -> tuple[Drive, Evolution]:
    """`drive` with the bristle that fits the friction behind reversals, by differential evolution."""
    motions = [as_arrays(_reversal_data(along, drive)) for along in measured_friction(list(logs), drive, dynamics)[0]]
    unknowns = unknowns_of(drive, 0.0)
    free = tuple(
        default_bounds(path, float(value.positive), 0.0)
        for path in free_paths(unknowns)
        if path.startswith("bristle") and (value := getattr(unknowns, path.split(".")[0])) is not None
    )
    space = search_space(unknowns, free)
    sample_count = sum(float(motion.counts.sum()) for motion in motions)

    def costs(shares: Population) -> Float[np.ndarray, " s"]:
        points = jnp.asarray(theta_at(space, shares))
        origin = jnp.asarray(space.origin)
        misfits = (_misfits(space.free, points, origin, drive, unknowns, motion) for motion in motions)
        squares = sum(misfits, start=jnp.zeros(()))
        return np.sqrt(np.asarray(squares) / max(sample_count, 1.0))

    evolution = evolve(costs, origin_fractions(space), budget, population=POPULATION, seed=seed)
    return space.insert(unknowns, theta_at(space, evolution.share)).drive(drive), evolution


@eqx.filter_jit
def _misfits(
    free: tuple[FreeParameter, ...],
    points: Float[Array, "s k"],
    origin: Float[Array, " k"],
    drive: Drive,
    unknowns: Unknowns,
    motion: _ReversalData,
) -> Float[Array, " s"]:
    def misfit(theta: Float[Array, " k"]) -> Float[Array, ""]:
        candidate = SearchSpace(free, origin).insert(unknowns, theta).drive(drive)
        friction = friction_along(candidate, motion.velocity, motion.load, motion.period).friction
        return jnp.sum(motion.counts * (friction - motion.friction) ** 2)

    return lax.map(misfit, points, batch_size=BLOCK)


def _reversal_data(measured: MeasuredFriction, drive: Drive) -> _ReversalData:
    friction = drive.friction
    levels = friction.coulomb_screw, friction.load_coefficient, friction.breakaway_gap, friction.bristle_stiffness
    screw, slope, gap, stiffness = (float(interval.positive) for interval in levels)
    reach = REACH * (screw + slope * (float(friction.initial_load) + float(measured.load.mean())) + gap) / stiffness
    counts = np.zeros_like(measured.velocity)
    for interval in passes(measured)[1:]:
        travelled = np.abs(measured.position[interval] - measured.position[interval.start])
        if travelled.max() > reach:  # else the table rests, or creeps
            counts[interval] = travelled <= reach
    velocity, load, force = (jnp.asarray(signal) for signal in (measured.velocity, measured.load, measured.friction))
    return _ReversalData(velocity, load, force, jnp.asarray(counts), 1.0 / measured.rate)
