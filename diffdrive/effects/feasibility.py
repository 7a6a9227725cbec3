"""Whether a machine with these effects can be, and be computed: found before it runs, and the effect named."""

from typing import Any

import jax
import numpy as np

from diffdrive.effects import stages
from diffdrive.effects.base import Envelope, MachineEffect
from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.motion.motion import Limits


def motion_envelope(position: np.ndarray, velocity: np.ndarray, load: np.ndarray, period: float) -> Envelope:
    """Within what a motion (m, m/s, [n] each) under a load (N) moves a drive, sampled each `period` (s)."""
    ends = float(np.min(position)), float(np.max(position))
    speed, lowest = float(np.max(np.abs(velocity))), float(np.min(load))
    return Envelope(ends, speed, lowest, period * (len(position) - 1), period)


def limits_envelope(limits: Limits, sampling: Sampling) -> Envelope:
    """Within what any motion that keeps the limits of an axis moves it."""
    return Envelope(
        position=limits.stroke if np.all(np.isfinite(limits.stroke)) else None,
        speed=limits.speed if np.isfinite(limits.speed) else None,
        period=sampling.period,
    )


def require_feasible(drive: Drive, within: Envelope) -> None:
    """Raise `ParameterError` that names the effect which no machine can have, or with which none can be computed.

    Each parameter is in its range by then (`check_drive`). Traced values cannot be looked at and are passed over.
    """
    if not drive.effects or any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(drive)):
        return
    with np.errstate(all="ignore"):
        machine = drive
        for effect in drive.effects:
            if not isinstance(effect, MachineEffect):
                continue
            machine = effect.alter(machine)
            if problem := _broken(machine, within.load):
                raise ParameterError(f"effects.{effect.name}: with it {problem}")
        machine = stages.with_machine_effects(drive, drive.effects)
        for effect in drive.effects:
            if problem := effect.problem(machine, within):
                raise ParameterError(f"effects.{effect.name}: {problem}")


def _broken(drive: Drive, load: float) -> str | None:
    """What a machine cannot be, in words; friction under `load` (N) on the guides."""
    plant, friction = drive.plant, drive.friction
    if not np.all(np.asarray(plant.mass) > 0.0):
        return f"the moving mass is {_worst(plant.mass):g} kg: it must stay above 0"
    for side in ("positive", "negative"):
        guide = getattr(friction.load_coefficient, side) * (friction.initial_load + load)
        level = getattr(friction.coulomb_screw, side) + guide
        if not np.all(np.asarray(level) > 0.0):
            return f"the Coulomb friction in the {side} direction is {_worst(level):g} N: it must stay above 0"
        breakaway = level + getattr(friction.breakaway_gap, side)
        if not np.all(np.asarray(breakaway) > 0.0):
            return f"the breakaway friction in the {side} direction is {_worst(breakaway):g} N: it must stay above 0"
        drag = getattr(friction.viscous, side) + getattr(plant.damping, side)
        if not np.all(np.asarray(drag) >= 0.0):
            return (
                f"viscous friction and damping in the {side} direction are {_worst(drag):g} N s/m: they must not drive "
                "the table"
            )
    finite = jax.tree.map(lambda leaf: bool(np.all(np.isfinite(leaf))), (plant, friction))
    return None if all(jax.tree.leaves(finite)) else "plant or friction are beyond all numbers"


def _worst(values: Any) -> float:
    return float(np.min(values))
