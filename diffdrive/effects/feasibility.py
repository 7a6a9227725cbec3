"""Whether a machine with these effects is physically possible and can be computed, checked before it runs."""

import jax
import numpy as np

from diffdrive.effects import stages
from diffdrive.effects.base import Envelope, MachineEffect
from diffdrive.errors import ParameterError
from diffdrive.model.parameters import Drive, Sampling, friction_problem
from diffdrive.motion.motion import Limits
from diffdrive.numerics.arrays import Scalar


def motion_envelope(position: np.ndarray, velocity: np.ndarray, load: np.ndarray, period: float) -> Envelope:
    """The envelope of a motion (m, m/s, [n] each) under a load (N, [n]), sampled each `period` (s)."""
    position_range = float(np.min(position)), float(np.max(position))
    speed, lowest = float(np.max(np.abs(velocity))), float(np.min(load))
    return Envelope(position_range, speed, lowest, period * (len(position) - 1), period)


def limits_envelope(limits: Limits, sampling: Sampling) -> Envelope:
    """The envelope of all motions within the limits of an axis."""
    return Envelope(
        position=limits.stroke if np.all(np.isfinite(limits.stroke)) else None,
        speed=limits.speed if np.isfinite(limits.speed) else None,
        period=sampling.period,
    )


def require_feasible(drive: Drive, envelope: Envelope) -> None:
    """Raise `ParameterError` naming the effect that is physically impossible or cannot be computed.

    Call `check_drive` first. Traced values are skipped.
    """
    if not drive.effects or any(isinstance(leaf, jax.core.Tracer) for leaf in jax.tree.leaves(drive)):
        return
    with np.errstate(all="ignore"):
        machine = drive
        for effect in drive.effects:
            if not isinstance(effect, MachineEffect):
                continue
            machine = effect.alter(machine)
            if problem := _infeasibility(machine, envelope.load):
                raise ParameterError(f"effects.{effect.name}: with it {problem}")
        machine = stages.with_machine_effects(drive, drive.effects)
        for effect in drive.effects:
            if problem := effect.problem(machine, envelope):
                raise ParameterError(f"effects.{effect.name}: {problem}")


def _infeasibility(drive: Drive, load: float) -> str | None:
    """Why no machine has these parameters under `load` (N) on the guides; None where one may."""
    plant, friction = drive.plant, drive.friction
    drags = friction.viscous + plant.damping
    if not np.all(np.asarray(plant.mass) > 0.0):
        return f"the moving mass is {_lowest(plant.mass):g} kg: it must stay above 0"
    if problem := friction_problem(friction, load):
        return problem
    for side in ("positive", "negative"):
        drag = getattr(drags, side)
        if not np.all(np.asarray(drag) >= 0.0):
            return (
                f"viscous friction and damping in the {side} direction are {_lowest(drag):g} N s/m: they must not "
                "drive the table"
            )
    finite = jax.tree.map(lambda leaf: bool(np.all(np.isfinite(leaf))), (plant, friction))
    return None if all(jax.tree.leaves(finite)) else "plant or friction are beyond all numbers"


def _lowest(values: Scalar | np.ndarray) -> float:
    return float(np.min(values))
