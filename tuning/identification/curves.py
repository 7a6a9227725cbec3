"""Friction curves measured from logs: over the velocity (Stribeck) and over the way since a reversal (hysteresis)."""

from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from scipy.ndimage import minimum_filter1d

from diffdrive.logs import Log
from diffdrive.model.friction import coulomb, steady_friction
from diffdrive.model.parameters import Drive
from tuning.identification.inverse_dynamics import DYNAMICS
from tuning.identification.measured_friction import MeasuredFriction, load_groups, measured_friction, passes

INERTIA_SHARE = 0.1  # of the Coulomb friction: at most this inertia force in a cruise
SPEED_CHANGE = 0.1  # of the speed while the bristle renews itself: faster, the friction lags behind the velocity
SETTLED = 5.0  # bristle lengths F_S / sigma_0 behind a reversal, where friction is steady again
HYSTERESIS_DECADES = 4.0  # of displacement, on a logarithmic axis


@dataclass(frozen=True)
class StribeckCurve:
    """Friction over the velocity under one applied load: arrays over the bins, in the order of the velocity.

    `friction` is the mean over the samples, damping included. Its `standard_error` is over passes, as neighbouring
    samples are no independent evidence; NaN from a single pass. `model` is what the drive's steady friction and damping
    make of the same velocities and loads.
    """

    load: float  # N
    velocity: Float[np.ndarray, " b"]  # m/s
    friction: Float[np.ndarray, " b"]  # N
    standard_error: Float[np.ndarray, " b"]  # N
    count: Int[np.ndarray, " b"]  # samples
    passes: Int[np.ndarray, " b"]
    model: Float[np.ndarray, " b"]  # N


@dataclass(frozen=True)
class StribeckCurves:
    """One curve per applied load; none, and a note that says why, where the logs have no steady motion."""

    curves: tuple[StribeckCurve, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class HysteresisCurve:
    """Friction over the way since a reversal into `direction` (+1 or -1) under one load: arrays over displacements."""

    load: float  # N
    direction: int
    displacement: Float[np.ndarray, " d"]  # m, from 0, then logarithmic
    median: Float[np.ndarray, " d"]  # N, over the reversals
    lower: Float[np.ndarray, " d"]  # N, first quartile
    upper: Float[np.ndarray, " d"]  # N, third quartile
    reversals: int


@dataclass(frozen=True)
class HysteresisCurves:
    """One curve per load and direction; none, and a note that says why, where the logs have no reversal."""

    curves: tuple[HysteresisCurve, ...]
    notes: tuple[str, ...]


def stribeck_curves(
    logs: Log | Sequence[Log],
    drive: Drive,
    *,
    dynamics: float = DYNAMICS,
    max_acceleration: float | None = None,
    min_speed: float | None = None,
    bins_per_decade: int = 10,
) -> StribeckCurves:
    """Friction over the velocity from the cruises of `logs`, beside the steady friction of `drive`.

    A cruise is where the acceleration stays below `max_acceleration` (m/s2; by default that at which the inertia force
    is a tenth of the Coulomb friction, and the speed changes by a tenth over one bristle length F_S / sigma_0), the
    speed above `min_speed` (m/s; by default one bristle length per second: slower, the table creeps or rests), and the
    table five bristle lengths or more behind its last reversal. The bins are centred on the same speeds for all logs:
    with ten per decade, on the preferred numbers 1, 1.25, 1.6, 2 ... at which machines run. Raises `LogError` as
    `tuning.identification.stretches` does.
    """
    measurements, notes = measured_friction(logs, drive, dynamics)
    cruises = [_cruise(measured, drive, dynamics, max_acceleration, min_speed) for measured in measurements]
    velocity, friction, load = (
        np.concatenate(
            [getattr(measured, name)[cruising] for measured, (cruising, _) in zip(measurements, cruises, strict=True)]
        )
        for name in ("velocity", "friction", "load")
    )
    if not len(velocity):
        why = (
            "no Stribeck curve: the logs have no stretch of steady motion (the acceleration is nowhere small for long)"
        )
        return StribeckCurves((), (*notes, why))
    numbers, before = [], 0
    for cruising, number in cruises:  # passes of all logs, numbered through
        numbers.append(number[cruising] + before)
        before += int(number[-1]) + 1
    pass_number = np.concatenate(numbers)
    model = np.asarray(
        steady_friction(drive.friction, jnp.asarray(velocity), jnp.asarray(load))
        + drive.plant.damping.towards(jnp.asarray(velocity)) * velocity
    )
    group = load_groups(load)
    curves = []
    for k in range(group.max() + 1):
        mask = group == k
        curves.append(
            _binned(velocity[mask], friction[mask], model[mask], load[mask], pass_number[mask], bins_per_decade)
        )
    return StribeckCurves(tuple(curves), notes)


def _cruise(
    measured: MeasuredFriction, drive: Drive, dynamics: float, max_acceleration: float | None, min_speed: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """Which samples cruise, and the number of the pass to which each belongs."""
    bristle = _bristle(drive, measured.velocity, measured.load)
    if max_acceleration is None:
        level = np.asarray(coulomb(drive.friction, jnp.asarray(measured.velocity), jnp.asarray(measured.load)))
        light = INERTIA_SHARE * level / float(drive.plant.mass)
        limit = np.minimum(light, SPEED_CHANGE * measured.velocity**2 / bristle)
    else:
        limit = np.full_like(measured.velocity, max_acceleration)
    behind = np.empty_like(measured.velocity)
    number = np.empty(len(measured.velocity), dtype=int)
    for k, stroke in enumerate(passes(measured)):
        behind[stroke] = np.abs(measured.position[stroke] - measured.position[stroke.start])
        number[stroke] = k
    slowest = bristle if min_speed is None else min_speed
    moving = (measured.velocity != 0) & (np.abs(measured.velocity) >= slowest)
    steady = moving & (np.abs(measured.acceleration) <= limit) & (behind >= SETTLED * bristle)
    reach = 2 * round(measured.rate / (5 * dynamics)) + 1  # what is not steady reaches so far through the filter
    return minimum_filter1d(steady.astype(np.uint8), reach) > 0, number


def _bristle(drive: Drive, direction: np.ndarray, load: np.ndarray) -> np.ndarray:
    """How far the bristle bends at breakaway, F_S / sigma_0, m, in the direction of a velocity."""
    friction = drive.friction
    towards = jnp.asarray(direction)
    level = coulomb(friction, towards, jnp.asarray(load)) + friction.breakaway_gap.towards(towards)
    return np.asarray(level / friction.bristle_stiffness.towards(towards))


def _binned(
    velocity: np.ndarray,
    friction: np.ndarray,
    model: np.ndarray,
    load: np.ndarray,
    pass_number: np.ndarray,
    per_decade: int,
) -> StribeckCurve:
    step = np.round(per_decade * np.log10(np.abs(velocity)))
    _, label = np.unique(np.stack([np.sign(velocity), step]), axis=1, return_inverse=True)
    label = label.ravel()
    count = np.bincount(label)

    def mean(signal: np.ndarray) -> np.ndarray:
        return np.bincount(label, signal) / count

    average = mean(friction)
    both, cluster = np.unique(np.stack([label, pass_number]), axis=1, return_inverse=True)
    excess = np.bincount(cluster.ravel(), friction - average[label])
    clusters = np.bincount(both[0])
    spread = np.bincount(both[0], excess**2)
    several = np.where(clusters > 1, clusters, np.nan)  # a single pass says nothing about the spread between passes
    error = np.sqrt(spread * several / (several - 1)) / count
    order = np.argsort(mean(velocity))
    return StribeckCurve(
        load=float(load.mean()),
        velocity=mean(velocity)[order],
        friction=average[order],
        standard_error=error[order],
        count=count[order],
        passes=clusters[order],
        model=mean(model)[order],
    )


def hysteresis_curves(
    logs: Log | Sequence[Log],
    drive: Drive,
    *,
    dynamics: float = DYNAMICS,
    reach: float | None = None,
    points: int = 100,
) -> HysteresisCurves:
    """Friction over the way since each reversal, the median and quartiles over the reversals of one direction and load.

    A reversal counts where the table travels `reach` (m; by default a tenth of the longest travel between reversals,
    and at least one bristle length F_S / sigma_0) before it in one direction and after it in the other. The filter
    blurs what happens within a / (2 f^2) of the reversal at an acceleration a and f = 5 x `dynamics`: give higher
    dynamics where the log is fast and clean enough. Raises `LogError` as `tuning.identification.stretches` does.
    """
    measurements, notes = measured_friction(logs, drive, dynamics)
    travelled = [[_travel(measured, stroke) for stroke in passes(measured)] for measured in measurements]
    if reach is None:
        bristle = max(float(np.max(_bristle(drive, np.array([v]), np.zeros(1)))) for v in (1.0, -1.0))
        reach = max(0.1 * max(max(travels) for travels in travelled), bristle)
    reversals = [
        (measured, stroke)
        for measured, travels in zip(measurements, travelled, strict=True)
        for stroke in _passes_after_reversals(measured, travels, reach)
    ]
    if not reversals:
        why = f"no hysteresis curve: the table nowhere reverses with {reach:.3g} m of travel before and after"
        return HysteresisCurves((), (*notes, why))
    displacement = np.concatenate([[0.0], np.geomspace(reach * 10**-HYSTERESIS_DECADES, reach, points - 1)])
    force = np.stack([_resampled(measured, stroke, displacement) for measured, stroke in reversals])
    direction = np.array([1 if measured.velocity[stroke.start] > 0 else -1 for measured, stroke in reversals])
    load = np.array([measured.load[stroke].mean() for measured, stroke in reversals])
    group = load_groups(load)
    curves = []
    for k in range(group.max() + 1):
        for side in (1, -1):
            mask = (group == k) & (direction == side)
            if mask.any():
                lower, median, upper = np.quantile(force[mask], [0.25, 0.5, 0.75], axis=0)
                curves.append(
                    HysteresisCurve(float(load[mask].mean()), side, displacement, median, lower, upper, int(mask.sum()))
                )
    return HysteresisCurves(tuple(curves), notes)


def _travel(measured: MeasuredFriction, stroke: slice) -> float:
    return float(np.ptp(measured.position[stroke]))


def _passes_after_reversals(measured: MeasuredFriction, travels: list[float], reach: float) -> list[slice]:
    """The passes of `reach` and more whose last such predecessor went the other way."""
    reversed_passes: list[slice] = []
    before: bool | None = None
    for stroke, travel in zip(passes(measured), travels, strict=True):
        if travel < reach:
            continue
        forwards = bool(measured.velocity[stroke.start] > 0)
        if before is not None and forwards != before:
            reversed_passes.append(stroke)
        before = forwards
    return reversed_passes


def _resampled(measured: MeasuredFriction, stroke: slice, displacement: np.ndarray) -> np.ndarray:
    """Friction at these displacements since the pass began."""
    way = np.maximum.accumulate(np.abs(measured.position[stroke] - measured.position[stroke.start]))
    return np.interp(displacement, way, measured.friction[stroke])
