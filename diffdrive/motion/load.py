"""Applied load on the guides over time (N): functions of the time grid, and a ramp of four numbers."""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from diffdrive.errors import MotionError
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar

__all__ = ["Ramp", "constant", "material_removal", "piecewise", "ramp", "step"]

GRAVITY = 9.80665  # m/s^2


class Ramp(NamedTuple):
    """A load (N) that changes linearly by `change` (N) from `begin` to `end` (s), constant outside: four numbers.

    For many lanes at once, each with its own load without an array over time.
    """

    load: Scalar  # N, before the change
    change: Scalar  # N
    begin: Scalar  # s
    end: Scalar  # s

    def at(self, time: Scalar) -> Scalar:
        """The load (N) at a time (s); where `end` does not come after `begin`, a step there."""
        share = (time - self.begin) / jnp.maximum(self.end - self.begin, 1e-9)
        return self.load + self.change * jnp.clip(share, 0.0, 1.0)


def constant(time: np.ndarray, load: float) -> np.ndarray:
    """The same load (N) throughout.

    Args:
        time: Of the samples, [n] (s): `motion.time`.
        load: On the guides (N).

    """
    return np.full(len(time), float(load))


def step(time: np.ndarray, *, at: float, to: float, before: float = 0.0) -> np.ndarray:
    """`before` (N) until `at` (s), `to` (N) from then on.

    Args:
        time: Of the samples, [n] (s): `motion.time`.
        at: When it changes (s).
        to: The load from then on (N).
        before: The load until then (N).

    Raises:
        MotionError: The time is not finite.

    Examples:
        >>> simulate(axis, lap, load=step(lap.time, at=0.5, to=8_000.0))

    """
    if not np.isfinite(at):
        raise MotionError(f"load step: at = {at!r} must be a finite time in s")
    return np.where(np.asarray(time) < at, float(before), float(to))


def ramp(time: np.ndarray, *, start: float, end: float, to: float, before: float = 0.0) -> np.ndarray:
    """Linear from `before` (N) at `start` (s) to `to` (N) at `end` (s).

    Args:
        time: Of the samples, [n] (s): `motion.time`.
        start: When the change begins (s).
        end: When it is done (s).
        to: The load from then on (N).
        before: The load until the start (N).

    Raises:
        MotionError: The end does not come after the start.

    """
    return piecewise(time, times=[start, end], loads=[before, to])


def piecewise(time: np.ndarray, *, times: Sequence[float], loads: Sequence[float]) -> np.ndarray:
    """Linear between the points (times s, loads N), constant outside.

    Args:
        time: Of the samples, [n] (s): `motion.time`.
        times: Of the points, increasing (s).
        loads: At the points (N).

    Raises:
        MotionError: The times do not increase, or there are not as many loads as times.

    """
    t, w = np.asarray(times, float), np.asarray(loads, float)
    if t.shape != w.shape or t.ndim != 1 or not len(t):
        raise MotionError("piecewise load: give as many times as loads, at least one of each")
    if not (np.all(np.isfinite(t)) and np.all(np.isfinite(w))):
        raise MotionError("piecewise load: times and loads must be finite")
    if np.any(np.diff(t) <= 0):
        raise MotionError(f"piecewise load: times must increase, got {list(times)!r}")
    return np.interp(time, t, w)


def material_removal(
    time: np.ndarray, *, workpiece: float, removal_rate: float, cuts: Sequence[tuple[float, float]]
) -> np.ndarray:
    """Weight of a workpiece (kg) that loses `removal_rate` (kg/s) while cutting; `cuts` are (from, to) in s.

    Args:
        time: Of the samples, [n] (s): `motion.time`.
        workpiece: Its mass at the start (kg).
        removal_rate: What a cut takes off (kg/s).
        cuts: From when to when each cut lasts (s).

    Raises:
        MotionError: A cut ends before it starts, or the workpiece is used up.

    """
    time = np.asarray(time, float)
    if not (0 <= workpiece < np.inf and 0 <= removal_rate < np.inf):
        raise MotionError(
            f"material removal: workpiece = {workpiece!r} kg and removal_rate = {removal_rate!r} kg/s must be finite, "
            "0 or more"
        )
    if any(not end > start for start, end in cuts):
        raise MotionError(f"material removal: each cut must end after it starts, got {list(cuts)!r}")
    cutting = sum((np.clip(time, start, end) - start for start, end in cuts), np.zeros(len(time)))
    mass = workpiece - removal_rate * cutting
    if np.any(mass < 0):
        raise MotionError(
            f"material removal: the {workpiece:g} kg workpiece is used up at t = {time[np.argmax(mass < 0)]:g} s: "
            "cut less, more slowly, or a heavier one"
        )
    return GRAVITY * mass


def require_resolved_friction(drive: Drive, max_load: Scalar, max_speed: float, sampling: Sampling) -> None:
    """Raise `MotionError` where rounding of the friction force alone moves the table as fast as the motion.

    `max_load` is in N, `max_speed` in m/s; drive and load are numbers, or arrays over machines. A force F has a
    rounding error of eps F, which in a substep h is a velocity of eps F h / M.
    """
    friction = drive.friction
    forces = friction.coulomb_at(max_load) + friction.breakaway_gap.map(lambda gap: np.maximum(gap, 0.0))
    step = sampling.period / sampling.plant_steps
    for force in (forces.positive, forces.negative):
        rounding = np.max(np.finfo(float).eps * step * np.asarray(force) / np.asarray(drive.plant.mass))
        if max_speed > 0.0 and rounding > max_speed:
            raise MotionError(
                f"under a load of {np.max(max_load):g} N the rounding of the friction, {np.max(force):.3g} N, alone "
                f"moves the table by {rounding:.2g} m/s, the motion by {max_speed:.2g}: check the units of [friction], "
                "load and speed"
            )


def validated_load(drive: Drive, load: np.ndarray | Sequence[float] | float, time: np.ndarray) -> np.ndarray:
    """The load (N, [n]) unchanged; raises `MotionError` unless it is finite, [n], and above minus the preload."""
    load = np.asarray(load, float)
    if load.shape != np.shape(time):
        raise MotionError(f"the load has shape {load.shape}, the motion {len(time)} samples: give one load per sample")
    if not np.all(np.isfinite(load)):
        raise MotionError(
            f"the load is not finite at t = {time[int(np.argmin(np.isfinite(load)))]:g} s: give newtons throughout"
        )
    lowest = -float(drive.friction.initial_load)
    if np.any(load < lowest):
        k = int(np.argmax(load < lowest))
        raise MotionError(
            f"the load of {load[k]:g} N at t = {time[k]:g} s lifts the table off its guides: it must stay above "
            f"minus the initial load, {lowest:g} N"
        )
    return load
