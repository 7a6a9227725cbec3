"""A drive with effects follows its logs: an extended Kalman filter.

Most effects are a signal like any other (`effect_signals`). Those in a loop with the table's velocity and friction are
stepped within the filter (`coupled`). How the innovations answer small changes: `derivatives`.
"""

from collections.abc import Sequence
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, Int, PyTree

from diffdrive.effects import stages
from diffdrive.effects.base import Effect, TableEffect
from diffdrive.effects.two_mass import Sensitivity
from diffdrive.model import plant
from diffdrive.model.friction import coulomb
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.observers.kalman import diagonal, kalman_gain, predict_covariance, update_covariance
from tuning.diagnosis.filter import motor_state
from tuning.diagnosis.filter.effect_signals import EffectSignals, Trajectory
from tuning.diagnosis.filter.segments import segments
from tuning.diagnosis.levels import LOST
from tuning.identification.prediction import Lanes, initial_state, initial_velocity

UNKNOWN_VELOCITY = 1e-3  # m/s, standard deviation at the first sample
DISTURBANCE_TIME = 0.02  # s, that a missing force lasts
RESTART_STD = 1e-5  # m, standard deviation of the position when it does
QUIETEST = 1e-6  # the square of the scale of all noises, at least: a log that never changes shows no noise at all


class ProcessNoise(NamedTuple):
    """How large a force the model is trusted to lack: one that lasts `DISTURBANCE_TIME` s, and a white one."""

    ar1_std: Scalar  # N, standard deviation
    white_std: Scalar  # N, standard deviation of one value per period


class EkfResult(NamedTuple):
    """What the filter saw, [lanes, n] each: the table after each correction."""

    trajectory: Trajectory
    innovation: Float[Array, "lanes n"]  # m
    innovation_std: Float[Array, "lanes n"]  # m, standard deviation expected of it
    kalman_gain: tuple[Float[Array, "lanes n"], ...]  # gains of position, velocity, bristle and lacking force
    deviance: Float[Array, ""]  # -2 log likelihood up to a constant, the scale of all noises free
    noise_scale_sq: Float[Array, ""]
    motor_deflection: Float[Array, "lanes n"] | None = None  # m, against the table, behind a screw

    @property
    def normalised_innovation(self) -> Float[Array, "lanes n"]:
        """Each innovation over the standard deviation expected of it."""
        return self.innovation / self.innovation_std

    @property
    def disturbance(self) -> Float[Array, "lanes n"]:
        """Force that the model lacks (N)."""
        return self.trajectory.disturbance


def force_per_innovation(filtered: EkfResult, drive: Drive, rate: float) -> Float[np.ndarray, "lanes n"]:
    """The sudden force (N) that the filter invents per metre of each innovation."""
    return float(drive.plant.mass) * rate * np.asarray(filtered.kalman_gain[1])


def _begun(
    drive: Drive,
    under: EffectSignals,
    coupled: tuple[Effect, ...],
    trajectory: Trajectory,
    load: Float[Array, " n"],
    begins: Int[np.ndarray, " s"],
    period: float,
) -> tuple[PyTree, ...]:
    """States, [s] each, of a lane's coupled effects at the samples where its segments begin.

    What forgets within a segment's lead begins at rest; the others are where following `trajectory` brings them.
    """
    rest = stages.initial_states(coupled, under.force[0])

    def step(states: tuple[PyTree, ...], at: PyTree) -> tuple[tuple[PyTree, ...], tuple[PyTree, ...]]:
        count, acts, load, table, travel = at
        seen, machine = acts.seen(count * period, table, load), stages.with_friction_offset(drive, acts)
        ahead = (
            one.state_after_travel(state, seen, travel, machine, period)
            for one, state in zip(lasting, states, strict=True)
        )
        return tuple(ahead), states

    lasting = tuple(effect for effect in coupled if isinstance(effect, TableEffect) and effect.has_memory)
    count = jnp.arange(len(load), dtype=load.dtype)
    travel = jnp.diff(trajectory.position, append=trajectory.position[-1:])
    along = lax.scan(step, stages.initial_states(lasting, under.force[0]), (count, under, load, trajectory, travel))[1]
    found = iter(jax.tree.map(lambda leaf: leaf[begins], along))
    return tuple(
        next(found) if effect in lasting else jax.tree.map(lambda leaf: jnp.zeros(len(begins)) + leaf, state)
        for effect, state in zip(coupled, rest, strict=True)
    )


def run_filter(
    drive: Drive,
    under: EffectSignals,
    coupled: tuple[Effect, ...],
    process_noise: ProcessNoise,
    noise: Scalar,
    lanes: Lanes,
    sampling: Sampling,
    trajectory: Trajectory | None = None,
) -> EkfResult:
    """Filter each lane; `coupled` are effects on the table, `noise` (m) is the measurement's standard deviation.

    `trajectory` is that of an earlier pass: what effects that remember begin each segment with. Without it they begin
    at rest.

    A white force alone would do while the table slides; where it sticks, the filter would blame its bristle for what
    the model lacks, and may then lock on to a motion in the wrong direction.
    """
    ar1_coeff = float(np.exp(-sampling.period / DISTURBANCE_TIME))
    ar1_variance = process_noise.ar1_std**2 * (1.0 - ar1_coeff**2)
    velocity_noise_var = (process_noise.white_std * sampling.period / drive.plant.mass) ** 2
    measured_variance = noise**2
    level = coulomb(drive.friction, 1.0, 0.0)
    loose = 0.5 * level / drive.friction.bristle_stiffness.positive  # how far the bristle may be off
    beside = (jnp.asarray(UNKNOWN_VELOCITY) ** 2, loose**2, process_noise.ar1_std**2)  # of all but the position
    shielded = motor_state.screw_of(coupled) is not None

    def body(carry: PyTree, at: PyTree) -> tuple[PyTree, PyTree]:
        (state, covariance, effects), (measured, load, acts, time, coupled, again) = carry, at
        innovation = measured - acts.scale - state[0]
        innovation_std = jnp.sqrt(covariance[0][0] + measured_variance)
        lost = jnp.abs(innovation) > LOST * innovation_std
        motor: Sequence[Scalar]
        motor = motor_state.regained(coupled, motor_state.read(coupled, effects), lost, drive, acts.force - acts.beside)
        state = (*state, *motor)
        covariance = tuple(
            tuple(jnp.where(lost, new, old) for new, old in zip(*rows, strict=True))
            for rows in zip(again, covariance, strict=True)
        )
        gain = kalman_gain(covariance, measured_variance)
        state = tuple(value + k * innovation for value, k in zip(state, gain, strict=True))
        covariance = update_covariance(covariance, gain, measured_variance)
        state, covariance = once((state, covariance))
        position, velocity, deflection, disturbance, *motor = state
        effects = motor_state.written(coupled, effects, tuple(motor))
        machine = stages.with_friction_offset(drive, acts)
        resisting = cast(Array, stages.resistance(machine, velocity, deflection, load))  # of the scan's carry
        now = Trajectory(position, velocity, deflection, resisting, disturbance)
        answers: tuple[Sensitivity, ...] = ()
        if coupled:
            seen = acts.seen(time, now, load)
            effects, more, answers = motor_state.stepped(coupled, effects, seen, machine, sampling.period)
            both = (a + b for a, b in zip(acts, more, strict=False))
            acts = EffectSignals._make((*both, acts.scale, acts.beside, None if shielded else acts.ripple))
            machine = stages.with_friction_offset(drive, acts)

        nil = jnp.zeros_like(velocity)
        ways = motor_state.ways(nil, answers)
        table, force = plant.PlantState(nil, velocity, deflection), acts.force + disturbance
        step = (sampling.period, sampling.plant_steps)
        moved, columns = plant.advance_with_tangents(machine, table, force, load, *step, ways, acts.ripple)
        rows = motor_state.transition(columns, answers, ar1_coeff)
        ahead = (position + acts.shift + moved.position, moved.velocity, moved.bristle, ar1_coeff * disturbance)
        motor_vars = motor_state.velocity_noise_vars(coupled, velocity_noise_var)
        covariance = predict_covariance(covariance, rows, (0.0, velocity_noise_var, 0.0, ar1_variance, *motor_vars))
        shown = (now, innovation, innovation_std, gain[: len(ahead)], motor[0] if motor else None)
        return (ahead, covariance, effects), shown

    pieces = segments(lanes.position.shape[1], sampling.rate)
    time = jnp.asarray(pieces.samples * sampling.period)

    def segment(
        lane: Lanes,
        acts: EffectSignals,
        time: Float[Array, " m"],
        effects: tuple[PyTree, ...],
        coupled: tuple[Effect, ...],
    ) -> PyTree:
        table = initial_state(drive, lane)
        begin = (table.position - acts.scale[0], table.velocity, table.bristle, jnp.zeros(()))
        usual = jnp.sqrt(jnp.mean((acts.force - acts.beside) ** 2))
        spread = (*beside, *motor_state.unknown(coupled, drive, usual))
        again = diagonal((jnp.asarray(RESTART_STD) ** 2, *spread))
        # what begins as a constant and differs from lane to lane later has JAX trace the loop once more for each batch
        nil = 0.0 * (lane.position[0] + acts.force[0] + process_noise.ar1_std)
        first = (begin, diagonal((measured_variance, *spread)), effects)
        carry = jax.tree.map(
            lambda leaf: leaf + nil if jnp.issubdtype(jnp.result_type(leaf), jnp.inexact) else leaf, first
        )

        def step(carry: PyTree, at: PyTree) -> tuple[PyTree, PyTree]:
            return body(carry, (*at, coupled, again))

        along = (lane.position, lane.load, acts._replace(ripple=in_substeps(acts, sampling)), time)
        return lax.scan(step, carry, along)[1]

    def begun(
        lane: Lanes, acts: EffectSignals, coupled: tuple[Effect, ...], trajectory: Trajectory | None
    ) -> tuple[PyTree, ...]:
        begins = pieces.samples[:, 0]
        if trajectory is None:
            rest = stages.initial_states(coupled, acts.force[0])
            return jax.tree.map(lambda leaf: jnp.zeros(len(begins)) + leaf, rest)
        return _begun(drive, acts, coupled, trajectory, lane.load, begins, sampling.period)

    def one(lane: Lanes, acts: EffectSignals, coupled: tuple[Effect, ...], states: tuple[PyTree, ...]) -> PyTree:
        signals = lane._replace(velocity=None)  # type: ignore[arg-type]  # None is no leaf: it has no samples to cut
        cut = jax.tree.map(pieces.cut, signals)
        velocity = initial_velocity(cut.position, sampling.rate).at[0].set(lane.velocity)
        beside = (cut._replace(velocity=velocity), jax.tree.map(pieces.cut, acts), time, states)
        found = jax.vmap(segment, (0, 0, 0, 0, None))(*beside, coupled)
        return jax.tree.map(pieces.joined, found)

    # side by side: one after the other takes as long for each
    states = jax.vmap(begun)(lanes, under, coupled, trajectory)
    found = lax.map(lambda each: one(*each), (lanes, under, coupled, states))
    trajectory, innovation, innovation_std, gain, motor = found
    return EkfResult(
        trajectory, innovation, innovation_std, gain, *deviance_of(innovation, innovation_std, lanes.counts), motor
    )


compiled_filter = eqx.filter_jit(run_filter)  # traced once for all programs that call this


def in_substeps(acts: EffectSignals, sampling: Sampling) -> Float[Array, "*lanes n substeps"] | None:
    """The ripple of each substep of each sample."""
    if acts.ripple is None:
        return None
    return jnp.repeat(acts.ripple, sampling.plant_steps // acts.ripple.shape[-1], axis=-1)


def deviance_of(innovation: Array, innovation_std: Array, counts: Array) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """-2 log likelihood up to a constant, and the square of the scale of all noises, which is free."""
    squares = jnp.minimum((innovation / innovation_std) ** 2, LOST**2)  # how far a lost filter was off says no more
    size = jnp.maximum(jnp.sum(counts * squares) / jnp.sum(counts), QUIETEST)
    return jnp.sum(counts) * jnp.log(size) + 2.0 * jnp.sum(counts * jnp.log(innovation_std)), size
