"""Correct logs of another machine, or under another controller, than the drive file's."""

from dataclasses import replace

import jax.numpy as jnp
import numpy as np

from diffdrive.controllers import PD, Cascade, Controller, Reference
from diffdrive.errors import ResultError
from diffdrive.logs.log import Log
from diffdrive.model.parameters import Drive
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import as_arrays
from experiments.studies.log_study.controllers import FittedVelocity, replayed_command
from experiments.studies.log_study.drives import StudyDrive
from experiments.studies.log_study.fault import COMMAND_SHARE, FaultKind, LogFault, log_uniform
from experiments.studies.log_study.sound import LogCase, scaled_drive, simulate_log
from experiments.studies.log_study.values import controller_known

MIN_COMMAND_CHANGE = 0.15  # change of the command, of its standard deviation, from which a machine counts as another


def differs(log: Log, other_log: Log) -> bool:
    """Whether the same motion took another command."""
    return bool(np.std(log.command - other_log.command) > MIN_COMMAND_CHANGE * np.std(log.command))


def _machine_fault(case: LogCase, machine: Drive, amount: str) -> LogFault | None:
    try:
        log = simulate_log(case.drive, machine, case.motion, case.seed)
    except ResultError:
        return None
    return LogFault(log, log, amount, ("other machine",)) if differs(case.log, log) else None


def other_machine(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """Mass x 0.5 to 2, Coulomb friction x 0.2 to 3, per direction."""
    mass = log_uniform(rng, 0.5, 2.0)
    friction = [log_uniform(rng, 0.2, 3.0) for _ in range(2)]
    amount = f"mass x {mass:.3g}, friction x {friction[0]:.3g} and {friction[1]:.3g}"
    return _machine_fault(case, scaled_drive(case.axis.drive, mass, friction), amount)


def lost_preload(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """The preload is lost: a fifth of the friction."""
    return _machine_fault(case, scaled_drive(case.machine, 1.0, 0.2), "friction x 0.2")


def _controller_fault(case: LogCase, controller: Controller, amount: str) -> LogFault | None:
    """A log of another controller's loop; None where the drive file's would have commanded the same in it."""
    try:
        log = simulate_log(case.drive, case.machine, case.motion, case.seed, controller)
    except ResultError:
        return None
    motion = case.motion
    reference = Reference(*(jnp.asarray(signal) for signal in (motion.position, motion.velocity, motion.acceleration)))
    controller, reference = as_arrays((case.axis.controller, reference))
    position, command = jnp.asarray(log.position), jnp.asarray(log.command)
    replayed = replayed_command(controller, reference, position, command, 1.0 / case.drive.rate)
    difference = log.command - np.asarray(replayed)
    difference -= np.mean(difference)  # an integral's value before the log began
    return (
        LogFault(log, log, amount, ("other controller",))
        if np.std(difference) > COMMAND_SHARE * np.std(log.command)
        else None
    )


def other_gains(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """Each gain off by 10 to 50 %, not all by the same factor: that would be the command's unit."""
    names = ("kp", "kv") if case.drive.feedback["kind"] == "cascade" else ("kp", "kd")
    factors = [1.0 + rng.uniform(0.1, 0.5) * float(rng.choice([-1.0, 1.0])) for _ in names]
    if abs(factors[0] / factors[1] - 1.0) < 0.1:
        return None
    gains = {name: factor * case.drive.feedback[name] for name, factor in zip(names, factors, strict=True)}
    amount = ", ".join(f"{name} x {factor:.3g}" for name, factor in zip(names, factors, strict=True))
    return _controller_fault(case, case.drive.with_feedback(gains).controller, amount)


def fitted_velocity(case: LogCase, rng: np.random.Generator) -> LogFault | None:
    """A velocity from a line through four samples in place of a difference."""
    controller = case.axis.controller
    assert isinstance(controller, PD | Cascade)
    return _controller_fault(case, FittedVelocity.of(controller), "velocity by a 4-point fit")


def _uses_differences(drive: StudyDrive) -> bool:
    return isinstance(drive.axis.controller, PD | Cascade)


def lost_motion(case: LogCase, rng: np.random.Generator) -> LogFault:
    """20 to 400 um of play between the encoder at the motor and the scale: at a reversal the motor crosses it first."""
    assert case.log.motor_position is not None
    play = log_uniform(rng, 20e-6, 400e-6)
    log = replace(
        case.log, motor_position=case.log.motor_position + 0.5 * play * play_side(case.motion, case.drive.rate)
    )
    return LogFault(log, log, f"{1e6 * play:.3g} um", ("lost motion",), ("motor_position", "position"))


def play_side(motion: Motion, rate: float) -> np.ndarray:
    """The side of its play on which the motor lies, -1 to 1; it crosses in 10 ms as the motion begins or reverses."""
    speed = np.abs(motion.velocity)
    at_rest = speed < 1e-6 * np.max(speed)  # a sum of pieces does not rest at zero exactly
    direction = np.where(at_rest, 0.0, np.sign(motion.velocity))
    last_moving = np.maximum.accumulate(np.where(direction != 0.0, np.arange(len(direction)), 0))
    direction = direction[last_moving]
    width = max(1, round(0.01 * rate))
    padded = np.concatenate([np.full(width, direction[0]), direction])
    sums = np.cumsum(padded)
    return (sums[width:] - sums[:-width]) / width


MACHINE_FAULTS = (
    FaultKind("another machine", other_machine),
    FaultKind("friction fallen to a fifth", lost_preload),
    FaultKind("other gains", other_gains, controller_known),
    FaultKind("velocity by a 4-point fit", fitted_velocity, _uses_differences),
    FaultKind("lost motion", lost_motion, lambda drive: drive.motor_resolution is not None),
)


def log_of_altered_machine(
    case: LogCase, motion: Motion, rng: np.random.Generator, *, mass: bool
) -> tuple[Log, str] | None:
    """A log of another motion, on a machine whose mass or Coulomb friction differs by a factor of 1.3 to 3.

    None where that machine would not have shown in this motion, or is unstable.
    """
    factor = log_uniform(rng, 1.3, 2.0 if mass else 3.0) ** float(rng.choice([-1.0, 1.0]))
    machine = scaled_drive(case.machine, *((factor, 1.0) if mass else (1.0, factor)))
    seed = case.seed + 1
    try:
        same = simulate_log(case.drive, case.machine, motion, seed)
        other = simulate_log(case.drive, machine, motion, seed)
    except ResultError:
        return None
    return (other, f"{'mass' if mass else 'friction'} x {factor:.3g}") if differs(same, other) else None
