"""What the filter has to know beside the table: the motor behind a screw.

What strikes the table tells where the motor was. A filter that only runs it along, at whatever the model says, mistimes
every blow after the first that it mistimed, and finds fault with the true gap as with any other.
"""

import jax.numpy as jnp
from jaxtyping import PyTree

from diffdrive.effects import stages
from diffdrive.effects.base import Acts, Seen
from diffdrive.effects.stages import Effects
from diffdrive.effects.transmission import Transmission
from diffdrive.effects.two_mass import Sensitivity
from diffdrive.model import plant
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar
from diffdrive.observers.kalman import Matrix

UNKNOWN_RATE = 1e-3  # m/s, standard deviation of the motor's against the table
States = tuple[PyTree, ...]


def screw_of(effects: Effects) -> int | None:
    """Which of the effects hides the motor; None where none does."""
    return next((k for k, effect in enumerate(effects) if isinstance(effect, Transmission)), None)


def _transmission(effects: Effects, which: int) -> Transmission:
    effect = effects[which]
    assert isinstance(effect, Transmission)  # by `screw_of`
    return effect


def unknown(effects: Effects, drive: Drive, force: Scalar) -> tuple[Scalar, ...]:
    """Variances of deflection and rate of a motor of which nothing is known but its usual `force` (N); nothing where
    none is hidden.
    """
    which = screw_of(effects)
    if which is None:
        return ()
    return (_transmission(effects, which).screw.lost_motion(drive, force) ** 2, jnp.asarray(UNKNOWN_RATE) ** 2)


def velocity_noise_vars(effects: Effects, velocity_noise_var: Scalar) -> tuple[Scalar, ...]:
    """What a force that gives the table's velocity this variance adds, acting on the motor, to the motor's own."""
    which = screw_of(effects)
    return () if which is None else (0.0, velocity_noise_var / _transmission(effects, which).screw.motor_share ** 2)


def read(effects: Effects, states: States) -> tuple[Scalar, ...]:
    """Deflection (m) and rate (m/s) of the motor against the table."""
    which = screw_of(effects)
    return () if which is None else tuple(states[which].relative)


def regained(
    effects: Effects, motor: tuple[Scalar, ...], lost: Scalar, drive: Drive, force: Scalar
) -> tuple[Scalar, ...]:
    """The motor at rest, no further off than its `force` (N) bends the screw, if all was `lost`: bouncing as it did, it
    would be lost for good.
    """
    which = screw_of(effects)
    if which is None:
        return ()
    side, (deflection, rate) = _transmission(effects, which).screw.lost_motion(drive, force), motor
    return jnp.where(lost, jnp.clip(deflection, -side, side), deflection), jnp.where(lost, 0.0, rate)


def written(effects: Effects, states: States, found: tuple[Scalar, ...]) -> States:
    """The states with the motor where it was found."""
    which = screw_of(effects)
    if which is None:
        return states
    motor = states[which]
    motor = motor._replace(relative=type(motor.relative)(*found))
    return (*states[:which], motor, *states[which + 1 :])


def stepped(
    effects: Effects, states: States, seen: Seen, drive: Drive, period: float
) -> tuple[States, Acts, tuple[Sensitivity, ...]]:
    """What acts on the table, and how that answers its velocity and bristle and, where one is hidden, the motor."""
    which = screw_of(effects)
    if which is None:
        states, acts = stages.table_action(effects, states, seen, drive, period)
        return states, acts, ()
    others, theirs = ((*some[:which], *some[which + 1 :]) for some in (effects, states))
    theirs, acts, before = stages.table_action_in_order(others, theirs, seen, drive, period)
    motor, own, answers = _transmission(effects, which).step_with_sensitivities(states[which], *before, period)
    return (*theirs[:which], motor, *theirs[which:]), acts.plus(own), answers


def ways(nil: Scalar, answers: tuple[Sensitivity, ...]) -> list[tuple[plant.PlantState, Scalar]]:
    """Along what the table's period is differentiated: velocity, bristle, force and, where one is hidden, the motor."""
    one = jnp.ones_like(nil)
    still = plant.PlantState(nil, nil, nil)
    by_velocity, by_bristle, *by_motor = [answer.force for answer in answers] or [nil, nil]
    table = [(still._replace(velocity=one), by_velocity), (still._replace(bristle=one), by_bristle), (still, one)]
    return table + [(still, force) for force in by_motor]


def transition(columns: list[plant.PlantState], answers: tuple[Sensitivity, ...], ar1_coeff: float) -> Matrix:
    """The transition of position, velocity, bristle, lacking force and, where one is hidden, the motor."""
    if not answers:
        return (*zip((1.0, 0.0, 0.0), *columns, strict=True), (0.0, 0.0, 0.0, ar1_coeff))
    shifts = [answer.shift for answer in answers]
    shifts.insert(2, 0.0)  # of the lacking force, which the motor does not see
    columns = [one._replace(position=one.position + more) for one, more in zip(columns, shifts, strict=True)]
    velocity, bristle, deflection, rate = answers
    motor = [
        (0.0, getattr(velocity, name), getattr(bristle, name), 0.0, getattr(deflection, name), getattr(rate, name))
        for name in ("deflection", "rate")
    ]
    return (*zip((1.0, 0.0, 0.0), *columns, strict=True), (0.0, 0.0, 0.0, ar1_coeff, 0.0, 0.0), *motor)
