"""Sound logs: a machine near its drive file, its controller, a motion, simulated with noise and counts."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt
from jax import lax
from jaxtyping import Array, Float

from diffdrive import motion
from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.effects import stages
from diffdrive.logs.log import Log
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.run import Run, with_status
from diffdrive.loop.step import Inputs, LoopState, initial_state, step
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.model.quantity import Directional
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import Scalar, as_arrays
from experiments.studies.log_study.drives import StudyDrive

# How far a sound machine is from its drive file: a CAD mass, and friction measured on another day.
MASS_SPREAD, FRICTION_SPREAD = 0.03, 0.1
MOTOR_NOISE = 3e-9  # m, of an encoder at the motor

# not `simulate`, which checks for each motion whether a load estimator converges at its speeds, and compiles for that
_rollout = eqx.filter_jit(rollout_loop)


@dataclass(frozen=True)
class LogCase:
    """A sound log, and what it was simulated from."""

    drive: StudyDrive
    machine: Drive
    motion: Motion
    seed: int
    log: Log

    @property
    def axis(self) -> Axis:
        """The axis that the checks are given beside a log."""
        return self.drive.axis


def motions(drive: StudyDrive) -> dict[str, Callable[[np.random.Generator], Motion]]:
    """Motions of this axis by name; all have the same length and begin at rest."""
    count = round(drive.seconds * drive.rate)
    time = np.arange(count) / drive.rate
    stroke, speed, acceleration, rate = drive.stroke, drive.speed, drive.acceleration, drive.rate

    def waves(*parts: tuple[float, float]) -> Motion:
        terms = (0.5 * size * (1.0 - np.cos(2.0 * np.pi * frequency * time)) for size, frequency in parts)
        position = sum(terms, start=np.zeros(count))
        return motion.from_array(time, position - 0.5 * np.ptp(position))

    def two_sines(rng: np.random.Generator) -> Motion:
        slow = speed / (np.pi * stroke) * rng.uniform(0.5, 0.9)
        return waves((stroke * rng.uniform(0.6, 0.8), slow), (0.1 * stroke, slow * rng.uniform(3.0, 4.5)))

    def strokes(rng: np.random.Generator) -> Motion:
        return motion.jerk_limited(
            distance=stroke * rng.uniform(0.5, 0.9), speed=speed * rng.uniform(0.5, 1.0), acceleration=acceleration,
            jerk=acceleration / 0.03, dwell=0.15, repeats=20, rate=rate, start=-0.4 * stroke,
        )  # fmt: skip

    def speeds(rng: np.random.Generator) -> Motion:
        return motion.staircase(
            speeds=(speed * np.array([0.5, 0.15, 1.0, 0.3]) * rng.uniform(0.7, 1.0)).tolist(), travel=0.25 * stroke,
            acceleration=acceleration, dwell=0.05, rate=rate,
        )  # fmt: skip

    def contour(rng: np.random.Generator) -> Motion:
        low = speed / (np.pi * stroke)
        return waves(
            *((stroke * share, low * often * rng.uniform(0.8, 1.2)) for share, often in
              ((0.4, 0.5), (0.2, 1.1), (0.12, 2.3), (0.05, 4.9)))
        )  # fmt: skip

    def with_length(make: Callable[[np.random.Generator], Motion]) -> Callable[[np.random.Generator], Motion]:
        return lambda rng: _of_length(make(rng), count)

    makers = {"two sines": two_sines, "strokes": strokes, "speeds": speeds, "contour": contour}
    return {name: with_length(make) for name, make in makers.items()}


def sound_log(drive: StudyDrive, rng: np.random.Generator) -> LogCase:
    """A sound log of a machine near its drive file."""
    name = str(rng.choice(sorted(motions(drive))))
    reference = motions(drive)[name](rng)
    machine = perturbed(drive.axis.drive, rng)
    seed = int(rng.integers(2**31))
    return LogCase(drive, machine, reference, seed, replace(simulate_log(drive, machine, reference, seed), name=name))


def perturbed(drive: Drive, rng: np.random.Generator) -> Drive:
    """The drive with mass and friction varied as far as drive files are off."""
    return scaled_drive(
        drive, rng.uniform(1 - MASS_SPREAD, 1 + MASS_SPREAD), rng.uniform(1 - FRICTION_SPREAD, 1 + FRICTION_SPREAD, 2)
    )


def scaled_drive(drive: Drive, mass: float, friction: npt.ArrayLike) -> Drive:
    """The drive with its mass, and its Coulomb friction per direction, times these factors."""
    forward, backward = np.broadcast_to(friction, 2)

    def scaled(value: Directional) -> Directional:
        return Directional(forward * value.positive, backward * value.negative)

    nominal = drive.friction
    scaled_friction = replace(
        nominal,
        coulomb_screw=scaled(nominal.coulomb_screw),
        load_coefficient=scaled(nominal.load_coefficient),
        breakaway_gap=scaled(nominal.breakaway_gap),
    )
    return replace(drive, plant=replace(drive.plant, mass=mass * drive.plant.mass), friction=scaled_friction)


def simulate_log(
    drive: StudyDrive, machine: Drive, reference: Motion, seed: int, controller: Controller | None = None
) -> Log:
    """The log of this machine on a motion; raises `ResultError` if its loop is unstable or saturates."""
    if controller is None:
        controller = drive.with_feedback({}).controller
    rest_samples = round(drive.settling_time * drive.rate)
    reference = _after_rest(reference, rest_samples)
    loads = np.full(len(reference.time), drive.load)
    machine, controller, inputs = *as_arrays((machine, controller)), loop_inputs(reference, loads)
    sampling, limits, key = drive.axis.sampling, drive.axis.limits, jax.random.key(seed)
    run = with_status(
        Run.from_frames(reference, loads, _rollout(machine, controller, inputs, sampling, key), 1), limits, None
    ).require_ok()
    signals = {name: np.asarray(getattr(run, name)) for name in ("time", "position", "command", "reference")}
    if drive.load:
        signals["load"] = np.asarray(run.load)
    if drive.motor_resolution is not None:
        deflection = _motor_deflection(machine, controller, inputs, sampling, key)
        noise = MOTOR_NOISE * np.random.default_rng(seed).standard_normal(len(reference.time))
        reading = run.table_position + np.asarray(deflection) + noise
        signals["motor_position"] = drive.motor_resolution * np.round(reading / drive.motor_resolution)
    channels: dict[str, Any] = {name: signal[rest_samples:] for name, signal in signals.items()}
    log = Log(drive.name, **channels)
    return replace(log, time=log.time - log.time[0])


@eqx.filter_jit
def _motor_deflection(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling, key: Array
) -> Float[Array, " n"] | Scalar:
    """The motor's position relative to the table (m), of a drive whose first effect is its transmission."""
    drive = stages.with_machine_effects(drive, drive.effects)

    def body(state: LoopState, sample: Inputs) -> tuple[LoopState, Scalar]:
        return step(drive, controller, sampling, key, state, sample)[0], state.effects[0].relative.deflection

    return lax.scan(body, initial_state(drive, controller, jnp.asarray(inputs.reference.position)[0]), inputs)[1]


def _after_rest(reference: Motion, samples: int) -> Motion:
    """The motion after so many samples at rest."""
    if not samples:
        return reference
    still = np.zeros(samples)
    return Motion(
        np.arange(samples + len(reference.time)) / reference.rate,
        np.concatenate([still + reference.position[0], reference.position]),
        np.concatenate([still, reference.velocity]),
        np.concatenate([still, reference.acceleration]),
        reference.name,
    )


def _of_length(reference: Motion, count: int) -> Motion:
    """The first samples of a motion; where it is shorter, it rests at its end."""
    if len(reference.time) < count:
        rest = count - len(reference.time)
        time = np.arange(count) / reference.rate
        still = np.zeros(rest)
        return Motion(
            time,
            np.concatenate([reference.position, np.full(rest, reference.position[-1])]),
            np.concatenate([reference.velocity, still]),
            np.concatenate([reference.acceleration, still]),
            reference.name,
        )
    return Motion(
        reference.time[:count],
        reference.position[:count],
        reference.velocity[:count],
        reference.acceleration[:count],
        reference.name,
    )
