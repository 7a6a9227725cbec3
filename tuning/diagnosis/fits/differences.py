"""How the innovations answer small changes, by differences of the whole filter.

For effects that are stepped within it: they answer the table, and the table answers them, so that no derivative along a
given course tells. What the logs tell a hundred times better than the prior is differenced again, over a step that is
no larger than that.
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from diffdrive.effects.stages import Effects
from diffdrive.model.parameters import Drive
from tuning.diagnosis.filter.derivatives import numbers, with_numbers
from tuning.diagnosis.filter.effect_signals import EffectSignals, Trajectory
from tuning.diagnosis.filter.ekf import EkfResult, ProcessNoise, compiled_filter
from tuning.diagnosis.hypotheses.calibration import NAMES
from tuning.diagnosis.hypotheses.model import Logged, Model, Vector, machine, signals_along, stacked

DIFFERENCE = 0.02  # in units of the prior
LEAST = 1e-9  # in units of the prior: less is lost in rounding
SMALL = 0.05  # of the scatter, RMS: a change of the residuals that is still linear
LARGER, SMALLER = 1.5, 10.0  # times the right step: what is still linear, and what is not yet lost in rounding
AT_ONCE = 4  # filters side by side; their segments are already

Ways = Int[np.ndarray, " w"]
Columns = Float[np.ndarray, "m w"]


@eqx.filter_jit
def _machines(
    logged: Logged, b: Float[Array, "s b"], effects: tuple[Effects, Effects], trajectory: Trajectory
) -> tuple[Drive, EffectSignals]:
    """The drive under each of several calibrations and sets of effects, and what acts on it."""

    def one(b: Float[Array, " b"], effects: tuple[Effects, Effects]) -> tuple[Drive, EffectSignals]:
        loose, coupled = effects
        own, drive = machine(logged, b, (*loose, *coupled))
        return drive, signals_along(logged, own, loose, trajectory)

    return jax.vmap(one)(b, effects)


@eqx.filter_jit
def _changed(
    drive: Drive,
    signals: EffectSignals,
    columns: Float[np.ndarray, "p m"],
    bend: EffectSignals,
    ways: Ways,
    steps: Vector,
) -> tuple[Drive, EffectSignals]:
    """A drive and what acts on it, so many steps along each of several ways."""

    def one(way: Int[Array | np.ndarray, ""], step: Float[Array | np.ndarray, ""]) -> tuple[Drive, EffectSignals]:
        moved = jax.tree.map(lambda at, along: at + step * along[..., way], signals._replace(ripple=None), bend)
        return with_numbers(drive, numbers(drive) + step * columns[:, way]), moved._replace(ripple=signals.ripple)

    return jax.vmap(one)(ways, steps)


@eqx.filter_jit
def _innovations(
    drives: Drive,
    signals: EffectSignals,
    coupled: Effects,
    logged: Logged,
    trajectory: Trajectory,
    process_noise: ProcessNoise,
) -> Float[Array, "s lanes n"]:
    """Of several machines side by side: one filter, whatever the effects that are stepped along the trajectory."""

    def one(drive: Drive, signals: EffectSignals, coupled: Effects) -> Float[Array, "lanes n"]:
        given = (logged.noise, logged.lanes, logged.sampling, trajectory)
        return compiled_filter(drive, signals, coupled, process_noise, *given).innovation

    return jax.vmap(one)(drives, signals, coupled)


def _by_steps(over: Callable[[Ways, Vector], Columns], size: int, ways: Ways, begin: Vector, samples: float) -> Columns:
    """`over` (differences along some ways, over a step each) for all `ways` of `size`; the others are zero.

    The steps are `begin` where these turn out to be of about the right size, else they are taken again.
    """
    first = over(ways, begin[ways])
    columns = np.zeros((len(first), size), order="F")
    columns[:, ways] = first
    steps = np.sign(begin) * _right_steps(columns, samples)
    ratio = steps[ways] / begin[ways]
    again = ways[(ratio < 1.0 / LARGER) | (ratio > SMALLER)]
    columns[:, again] = over(again, steps[again])
    return columns


def _right_steps(columns: Columns, samples: float) -> Vector:
    """Steps that change the residuals by `SMALL`, and none that is no small change of a parameter."""
    norms = np.linalg.norm(np.nan_to_num(columns, posinf=0.0, neginf=0.0), axis=0)
    return np.clip(SMALL * np.sqrt(samples) / np.maximum(norms, 1e-9), LEAST, DIFFERENCE)


def _in_blocks(ways: Ways, steps: Vector) -> list[tuple[Ways, Vector]]:
    """Blocks of `AT_ONCE`, the last filled up: one program for all."""
    fill = (0, -len(ways) % AT_ONCE)
    both = np.pad(ways, fill, mode="edge"), np.pad(steps, fill, mode="edge")
    return list(zip(*(np.split(one, len(one) // AT_ONCE) for one in both), strict=True))


def _slope(
    innovations: list[np.ndarray], from_there: np.ndarray, steps: Vector, filtered: EkfResult, logged: Logged
) -> Columns:
    """Slopes of the innovations over their scatter; none where a filter ran away, since that tells nothing."""
    count = len(steps)
    with np.errstate(invalid="ignore", over="ignore"):
        moved = np.concatenate(innovations)[:count] - from_there
        slope = moved / steps[:, None, None] / np.asarray(filtered.innovation_std) * np.asarray(logged.lanes.counts)
    return np.where(np.isfinite(slope), slope, 0.0).reshape(count, -1).T


def by_numbers(
    model: Model,
    theta: Vector,
    process_noise: Vector,
    filtered: EkfResult,
    trajectory: Trajectory,
    wanted: Ways,
    near: Columns | None = None,
) -> Float[np.ndarray, "m k"]:
    """Derivatives of the innovations of a hypothesis at `theta`, over their scatter, by the `wanted` numbers of theta.

    Each to the side away from the prior's edge; `trajectory` is the one along which `filtered` was computed. `near` are
    those of a point nearby, if known.
    """
    logged, forces = model.logged, ProcessNoise(*jnp.asarray(process_noise))
    counts = np.asarray(logged.lanes.counts)

    def over(ways: Ways, steps: Vector) -> Columns:
        if not ways.size:
            return np.zeros((counts.size, 0))
        found = []
        for few, by in _in_blocks(ways, steps):
            us = theta + np.eye(model.size)[few] * by[:, None]
            effects = stacked([model.apart(model.effects(one)) for one in us])
            drives, signals = _machines(logged, us[:, : len(NAMES)] @ model.prior, effects, trajectory)
            found.append(np.asarray(_innovations(drives, signals, effects[1], logged, trajectory, forces)))
        return _slope(found, np.asarray(filtered.innovation), steps, filtered, logged)

    sides = np.where(theta > 0.0, -1.0, 1.0)
    steps = DIFFERENCE if near is None else _right_steps(near, counts.sum())
    return _by_steps(over, model.size, wanted, sides * steps, counts.sum())


def by_acts(
    model: Model, theta: Vector, process_noise: Vector, filtered: EkfResult, drive: Drive, signals: EffectSignals,
    columns: Float[np.ndarray, "p m"], bend: EffectSignals, alone: Columns,
) -> Float[np.ndarray, "lanes n m"]:  # fmt: skip
    """Of the same innovations to changes of the drive's numbers (`columns`) and of what acts ([lanes, n, m]).

    `alone` is what these changes do, over the scatter, where nothing is stepped within the filter: how small they must
    be is of that order.
    """
    logged, forces = model.logged, ProcessNoise(*jnp.asarray(process_noise))
    counts, coupled = np.asarray(logged.lanes.counts), model.apart(model.effects(theta))[1]

    def innovations(ways: Ways, steps: Vector) -> np.ndarray:
        drives, acts = _changed(drive, signals, columns, bend, ways, steps)
        beside = stacked([coupled] * len(ways))
        return np.asarray(_innovations(drives, acts, beside, logged, filtered.trajectory, forces))

    def over(ways: Ways, steps: Vector) -> Columns:
        if not ways.size:
            return np.zeros((counts.size, 0))
        # the last without any step: along the last trajectory, as the others are
        found = [innovations(few, by) for few, by in _in_blocks(np.append(ways, 0), np.append(steps, 0.0))]
        return _slope(found, found[-1][-1], steps, filtered, logged)

    count = columns.shape[1]
    found = _by_steps(over, count, np.arange(count), _right_steps(alone, counts.sum()), counts.sum())
    return found.reshape(*counts.shape, count)
