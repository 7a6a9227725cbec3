"""A drive with effects follows its logs: an extended Kalman filter, and its derivative with respect to everything.

Most effects are a signal like any other (`exposure`). Those that act by the table's velocity and friction, and these by
them, are stepped within the filter (`coupled`). The innovations answer small changes linearly,

    e = e0 + d e / d b  b + d e / d (exposure)  d exposure ,

and that answer is a linear recursion along the log (`answers`), cheap enough for a hundred directions at once.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, Int, PyTree

from diffdrive.effects import stages
from diffdrive.effects.base import Effect, TableEffect
from diffdrive.effects.transmission import Sensitivity
from diffdrive.model import plant
from diffdrive.model.friction import coulomb
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.once import once
from diffdrive.observers.kalman import diagonal, kalman_gain, predict_covariance, update_covariance
from tuning.diagnosis.filter import hidden
from tuning.diagnosis.filter.exposure import Course, Exposure
from tuning.diagnosis.filter.segments import segments
from tuning.identification.prediction import Lanes, initial_state, initial_velocity

UNKNOWN_VELOCITY = 1e-3  # m/s, standard deviation at the first sample
LASTING = 0.02  # s, that a missing force lasts
LOST = 6.0  # scatters; a filter that is so far off begins again from the measurement
FOUND = 1e-5  # m, standard deviation of the position when it does
QUIETEST = 1e-6  # the square of the scale of all noises, at least: a log that never changes shows no noise at all
BATCH = 512  # samples that are differentiated at once


class Process(NamedTuple):
    """How large a force the model is trusted to lack: one that lasts `LASTING` s, and a white one."""

    lasting: Scalar  # N, standard deviation
    white: Scalar  # N, standard deviation of one value per period


class Track(NamedTuple):
    """What the filter saw, [lanes, n] each: the table after each correction."""

    course: Course
    innovation: Float[Array, "lanes n"]  # m
    scatter: Float[Array, "lanes n"]  # m, standard deviation expected of it
    pull: tuple[Float[Array, "lanes n"], ...]  # gains of position, velocity, bristle and lacking force
    deviance: Float[Array, ""]  # -2 log likelihood up to a constant, the scale of all noises free
    size: Float[Array, ""]  # that scale, squared
    motor: Float[Array, "lanes n"] | None = None  # m, its deflection against the table, where a screw hides it

    @property
    def lacking(self) -> Float[Array, "lanes n"]:
        """Force that the model lacks (N)."""
        return self.course.lacking


def per_innovation(track: Track, drive: Drive, rate: float) -> Float[np.ndarray, "lanes n"]:
    """The sudden force (N) that the filter invents per metre of each innovation."""
    return float(drive.plant.mass) * rate * np.asarray(track.pull[1])


class Slopes(NamedTuple):
    """Derivatives of the table after one period: [lanes, n, 3, directions]."""

    state: Float[Array, "lanes n 3 2"]  # with respect to velocity and bristle
    machine: Float[Array, "lanes n 3 p"]  # to the numbers of plant and friction, in the order of `numbers`
    exposure: Float[Array, "lanes n 3 4"]  # to force, Coulomb friction, gap and viscous friction


def numbers(drive: Drive) -> Float[Array, " p"]:
    """Plant and friction as one vector."""
    return ravel_pytree((drive.plant, drive.friction))[0]


def with_numbers(drive: Drive, values: Float[Array, " p"]) -> Drive:
    """The drive with plant and friction from such a vector."""
    plant, friction = ravel_pytree((drive.plant, drive.friction))[1](values)
    return dataclasses.replace(drive, plant=plant, friction=friction)


def _begun(
    drive: Drive,
    under: Exposure,
    coupled: tuple[Effect, ...],
    course: Course,
    load: Float[Array, " n"],
    begins: Int[np.ndarray, " s"],
    period: float,
) -> tuple[PyTree, ...]:
    """States, [s] each, of a lane's coupled effects at the samples where its segments begin.

    What forgets within a segment's lead begins at rest; the others are where following `course` brings them.
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
    count, travel = jnp.arange(len(load), dtype=load.dtype), jnp.diff(course.position, append=course.position[-1:])
    along = lax.scan(step, stages.initial_states(lasting, under.force[0]), (count, under, load, course, travel))[1]
    found = iter(jax.tree.map(lambda leaf: leaf[begins], along))
    return tuple(
        next(found) if effect in lasting else jax.tree.map(lambda leaf: jnp.zeros(len(begins)) + leaf, state)
        for effect, state in zip(coupled, rest, strict=True)
    )


def follow(
    drive: Drive,
    under: Exposure,
    coupled: tuple[Effect, ...],
    process: Process,
    noise: Scalar,
    lanes: Lanes,
    sampling: Sampling,
    course: Course | None = None,
) -> Track:
    """Filter each lane; `coupled` are effects on the table, `noise` (m) is the measurement's standard deviation.

    `course` is that of an earlier pass: what effects that remember begin each segment with. Without it they begin
    at rest.

    A white force alone would do while the table slides; where it sticks, the filter would blame its bristle for what
    the model lacks, and may then lock on to a motion in the wrong direction.
    """
    fade = float(np.exp(-sampling.period / LASTING))
    fresh = process.lasting**2 * (1.0 - fade**2)
    jolt = (process.white * sampling.period / drive.plant.mass) ** 2
    measured_variance = noise**2
    level = coulomb(drive.friction, 1.0, 0.0)
    loose = 0.5 * level / drive.friction.bristle_stiffness.positive  # how far the bristle may be off
    beside = (jnp.asarray(UNKNOWN_VELOCITY) ** 2, loose**2, process.lasting**2)  # of all but the position
    shielded = hidden.screw_of(coupled) is not None

    def body(carry: PyTree, at: PyTree) -> tuple[PyTree, PyTree]:
        (state, covariance, effects), (measured, load, acts, time, coupled, again) = carry, at
        innovation = measured - acts.scale - state[0]
        scatter = jnp.sqrt(covariance[0][0] + measured_variance)
        lost = jnp.abs(innovation) > LOST * scatter
        motor: Sequence[Scalar]
        motor = hidden.regained(coupled, hidden.read(coupled, effects), lost, drive, acts.force - acts.beside)
        state = (*state, *motor)
        covariance = tuple(
            tuple(jnp.where(lost, new, old) for new, old in zip(*rows, strict=True))
            for rows in zip(again, covariance, strict=True)
        )
        pull = kalman_gain(covariance, measured_variance)
        state = tuple(value + k * innovation for value, k in zip(state, pull, strict=True))
        covariance = update_covariance(covariance, pull, measured_variance)
        state, covariance = once((state, covariance))
        position, velocity, deflection, lacking, *motor = state
        effects = hidden.written(coupled, effects, tuple(motor))
        machine = stages.with_friction_offset(drive, acts)
        resisting = cast(Array, stages.resistance(machine, velocity, deflection, load))  # of the scan's carry
        now = Course(position, velocity, deflection, resisting, lacking)
        answers: tuple[Sensitivity, ...] = ()
        if coupled:
            seen = acts.seen(time, now, load)
            effects, more, answers = hidden.stepped(coupled, effects, seen, machine, sampling.period)
            both = (a + b for a, b in zip(acts, more, strict=False))
            acts = Exposure._make((*both, acts.scale, acts.beside, None if shielded else acts.ripple))
            machine = stages.with_friction_offset(drive, acts)

        nil = jnp.zeros_like(velocity)
        ways = hidden.ways(nil, answers)
        table, force = plant.PlantState(nil, velocity, deflection), acts.force + lacking
        step = (sampling.period, sampling.plant_steps)
        moved, columns = plant.advance_with_tangents(machine, table, force, load, *step, ways, acts.ripple)
        rows = hidden.transition(columns, answers, fade)
        ahead = (position + acts.shift + moved.position, moved.velocity, moved.bristle, fade * lacking)
        covariance = predict_covariance(covariance, rows, (0.0, jolt, 0.0, fresh, *hidden.jolted(coupled, jolt)))
        return (ahead, covariance, effects), (now, innovation, scatter, pull[: len(ahead)], motor[0] if motor else None)

    pieces = segments(lanes.position.shape[1], sampling.rate)
    time = jnp.asarray(pieces.samples * sampling.period)

    def segment(
        lane: Lanes,
        acts: Exposure,
        time: Float[Array, " m"],
        effects: tuple[PyTree, ...],
        coupled: tuple[Effect, ...],
    ) -> PyTree:
        table = initial_state(drive, lane)
        begin = (table.position - acts.scale[0], table.velocity, table.bristle, jnp.zeros(()))
        usual = jnp.sqrt(jnp.mean((acts.force - acts.beside) ** 2))
        spread = (*beside, *hidden.unknown(coupled, drive, usual))
        again = diagonal((jnp.asarray(FOUND) ** 2, *spread))

        def step(carry: PyTree, at: PyTree) -> tuple[PyTree, PyTree]:
            return body(carry, (*at, coupled, again))

        along = (lane.position, lane.load, acts._replace(ripple=_in_substeps(acts, sampling)), time)
        return lax.scan(step, (begin, diagonal((measured_variance, *spread)), effects), along)[1]

    def begun(lane: Lanes, acts: Exposure, coupled: tuple[Effect, ...], course: Course | None) -> tuple[PyTree, ...]:
        begins = pieces.samples[:, 0]
        if course is None:
            rest = stages.initial_states(coupled, acts.force[0])
            return jax.tree.map(lambda leaf: jnp.zeros(len(begins)) + leaf, rest)
        return _begun(drive, acts, coupled, course, lane.load, begins, sampling.period)

    def one(lane: Lanes, acts: Exposure, coupled: tuple[Effect, ...], states: tuple[PyTree, ...]) -> PyTree:
        signals = lane._replace(velocity=None)  # type: ignore[arg-type]  # None is no leaf: it has no samples to cut
        cut = jax.tree.map(pieces.cut, signals)
        velocity = initial_velocity(cut.position, sampling.rate).at[0].set(lane.velocity)
        beside = (cut._replace(velocity=velocity), jax.tree.map(pieces.cut, acts), time, states)
        found = jax.vmap(segment, (0, 0, 0, 0, None))(*beside, coupled)
        return jax.tree.map(pieces.joined, found)

    states = jax.vmap(begun)(lanes, under, coupled, course)  # side by side: one after the other takes as long for each
    found = lax.map(lambda each: one(*each), (lanes, under, coupled, states))
    course, innovation, scatter, pull, motor = found
    return Track(course, innovation, scatter, pull, *deviance_of(innovation, scatter, lanes.counts), motor)


followed = eqx.filter_jit(follow)  # traced once for all programs that call this


def _in_substeps(acts: Exposure, sampling: Sampling) -> Float[Array, "*lanes n substeps"] | None:
    """The ripple of each substep of each sample."""
    if acts.ripple is None:
        return None
    return jnp.repeat(acts.ripple, sampling.plant_steps // acts.ripple.shape[-1], axis=-1)


def deviance_of(innovation: Array, scatter: Array, counts: Array) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """-2 log likelihood up to a constant, and the square of the scale of all noises, which is free."""
    squares = jnp.minimum((innovation / scatter) ** 2, LOST**2)  # how far a lost filter was off says no more
    size = jnp.maximum(jnp.sum(counts * squares) / jnp.sum(counts), QUIETEST)
    return jnp.sum(counts) * jnp.log(size) + 2.0 * jnp.sum(counts * jnp.log(scatter)), size


def slopes(drive: Drive, under: Exposure, track: Track, lanes: Lanes, sampling: Sampling) -> Slopes:
    """Derivatives of every period, at the track, with respect to the state, the machine, and the exposure."""

    def period(args: PyTree, load: Scalar, ripple: Float[Array, " substeps"] | None) -> Float[Array, " 3"]:
        v, z, machine, force, coulomb, gap, viscous = args
        acts = Exposure(force, coulomb, gap, viscous, *(jnp.zeros(()) for _ in range(3)))
        table = plant.PlantState(jnp.zeros_like(v), v, z)
        bent = stages.with_friction_offset(with_numbers(drive, machine), acts)
        return jnp.stack(plant.advance(bent, table, force, load, sampling.period, sampling.plant_steps, ripple))

    def at(sample: PyTree) -> Float[Array, "3 directions"]:
        v, z, force, coulomb, gap, viscous, load, ripple = sample
        args = (v, z, numbers(drive), force, coulomb, gap, viscous)
        flat, again = ravel_pytree(args)
        jac = jax.vmap(lambda d: jax.jvp(lambda a: period(again(a), load, ripple), (flat,), (d,))[1], out_axes=1)(
            jnp.eye(len(flat))
        )
        return jac

    force = under.force + track.lacking
    course, ripple = track.course, _in_substeps(under, sampling)
    samples = (course.velocity, course.bristle, force, under.coulomb, under.gap, under.viscous, lanes.load, ripple)
    shape = track.lacking.shape
    flat = jax.tree.map(lambda one: one.reshape(-1, *one.shape[2:]), samples)
    jac = lax.map(at, flat, batch_size=BATCH)
    jac = jac.reshape(*shape, 3, -1)
    return Slopes(jac[..., :2], jac[..., 2:-4], jac[..., -4:])


def answers(
    track: Track, linear: Slopes, forcing: Float[Array, "lanes n 3 m"], scale: Float[Array, "lanes n m"], period: float
) -> Float[Array, "lanes n m"]:
    """Change of the innovations over their scatter, [lanes, n, m], for forcings of the table ([lanes, n, 3, m] after
    each period) and errors of the scale ([lanes, n, m]).
    """
    fade = float(np.exp(-period / LASTING))

    def one(args: PyTree) -> Float[Array, "n m"]:
        pull, scatter, state, push, forced, off = args

        def body(carry: PyTree, at: PyTree) -> tuple[PyTree, Float[Array, " m"]]:
            x, v, z, f = carry
            (kx, kv, kz, kf), s, a, p, d, shift = at
            e = -(x + shift)
            x, v, z, f = x + kx * e, v + kv * e, z + kz * e, f + kf * e
            ahead = [(x if row == 0 else 0.0) + a[row, 0] * v + a[row, 1] * z + p[row] * f + d[row] for row in range(3)]
            return (*ahead, fade * f), e / s

        m = forced.shape[-1]
        # the filter begins where the first sample was measured
        begin = (-off[0], *(jnp.zeros(m) for _ in range(3)))
        return lax.scan(body, begin, (pull, scatter, state, push, forced, off))[1]

    return lax.map(one, (track.pull, track.scatter, linear.state, linear.exposure[..., 0], forcing, scale))
