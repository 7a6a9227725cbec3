"""How far to trust the model against the measurement, at every sample: an extended Kalman filter along a log.

It carries the covariance of position, velocity and bristle with the exact derivative of one control period, so that its
gains rise where the falling Stribeck curve makes the motion unstable and vanish where the table rests. What the model
lacks is a white force on the table of `process` N (standard deviation per control period); how large it is, the
likelihood of the innovations shows: nothing for an exact model, newtons for a machine.
"""

from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.model import plant
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.directions import WHOLE
from diffdrive.numerics.once import once
from diffdrive.observers.kalman import (
    Matrix,
    Triangle,
    diagonal,
    kalman_gain,
    kalman_gain_along,
    predict_covariance,
    update_covariance,
    update_covariance_along,
)
from tuning.identification.prediction import (
    Corrections,
    FilterGains,
    Lanes,
    corrected,
    initial_state,
    wind_up,
)
from tuning.identification.row_force import BetweenRows, RowForce, advance, applied_force

PROCESS_FORCES = np.geomspace(1e-3, 1e3, 25)  # N, among which the likeliest is looked for
APART = 3  # of these, from one to the next of the first that are tried
INITIAL_VELOCITY_STD = 1e-3  # m/s, standard deviation at the first sample


Carry = tuple[plant.PlantState, Triangle]
Sums = tuple[Float[Array, ""], Float[Array, ""], Float[Array, ""]]
LinearisedPeriod = Callable[[plant.PlantState, RowForce, Scalar], tuple[plant.PlantState, Matrix]]


class FilterResult(NamedTuple):
    """Gains along the log, and how likely its innovations are."""

    gains: FilterGains
    innovation: Float[Array, "lanes n"]  # m
    deviance: Float[Array, ""]  # -2 log likelihood of the innovations, up to a constant
    motor_innovation: Float[Array, "lanes n"] | None = None  # m


def _linearised_period(drive: Drive, sampling: Sampling) -> LinearisedPeriod:
    """One control period and its derivative with respect to the state before it."""

    def ahead(velocity: Scalar, bristle: Scalar, force: RowForce, load: Scalar) -> plant.PlantState:
        state = plant.PlantState(jnp.zeros_like(velocity), velocity, bristle)
        return advance(drive, state, force, load, sampling)

    def both(state: plant.PlantState, force: RowForce, load: Scalar) -> tuple[plant.PlantState, Matrix]:
        _, velocity, bristle = state
        unit, zero = jnp.ones_like(velocity), jnp.zeros_like(velocity)

        def along(direction: tuple[Scalar, Scalar]) -> tuple[plant.PlantState, plant.PlantState]:
            return jax.jvp(lambda v, z: ahead(v, z, force, load), (velocity, bristle), direction)

        moved, by_velocity = along((unit, zero))
        _, by_bristle = along((zero, unit))
        rows = zip((1.0, 0.0, 0.0), by_velocity, by_bristle, strict=True)  # nothing depends on the position
        return moved._replace(position=state.position + moved.position), tuple(rows)

    return both


def run_filter(
    drive: Drive,
    delay: Scalar,
    process: Scalar,
    noise: Scalar,
    lanes: Lanes,
    sampling: Sampling,
    compliance: Scalar = 0.0,
    between: BetweenRows = BetweenRows.HELD,
) -> FilterResult:
    """Filter each lane; `noise` (m) is the measurement's, `process` (N) the model's, `compliance` (m/N) the screw's."""
    period = _linearised_period(drive, sampling)
    velocity_variance = (process * sampling.period / drive.plant.mass) ** 2
    measured_variance = noise**2

    def body(carry: Carry, sample: tuple[PyTree, ...]) -> tuple[Carry, tuple[FilterGains, Array, Array | None]]:
        state, covariance = carry
        measured, force, load, motor = sample
        innovation = measured - state.position
        innovation_std = jnp.sqrt(covariance[0][0] + measured_variance)
        gains = kalman_gain(covariance, measured_variance)
        state = corrected(state, gains, innovation)
        covariance = update_covariance(covariance, gains, measured_variance)
        corrections = motor_innovation = None
        if motor is not None:
            reading, counts, motor_noise = motor
            ahead, per_bristle = wind_up(drive, compliance, state.bristle)
            motor_innovation = reading - state.position - ahead
            gain, seen, variance = kalman_gain_along(covariance, (1.0, 0.0, per_bristle), motor_noise**2)
            gain = tuple(counts * one for one in gain)
            state = corrected(state, gain, motor_innovation)
            covariance = update_covariance_along(covariance, gain, seen, variance)
            position, velocity, bristle = (jnp.asarray(one) for one in gain)
            corrections = Corrections(position, velocity, bristle, jnp.sqrt(variance))
        state, covariance = once((state, covariance))
        state, moved = period(state, force, load)
        covariance = predict_covariance(covariance, moved, (0.0, velocity_variance, 0.0))
        position, velocity, bristle = (jnp.asarray(value) for value in gains)
        found = FilterGains(position, velocity, bristle, innovation_std, corrections)
        return (state, covariance), (found, innovation, motor_innovation)

    def filter_lane(lane: Lanes) -> tuple[FilterGains, Array, Array | None]:
        begin = initial_state(drive, lane)
        level = drive.friction.coulomb_at(lane.load[0]).positive
        bristle_std = 0.5 * level / drive.friction.bristle_stiffness.positive  # of its deflection at the start
        spread = diagonal((measured_variance, jnp.asarray(INITIAL_VELOCITY_STD) ** 2, bristle_std**2))
        force = applied_force(drive.actuator, lane.command, delay, sampling.period, between)
        force = force._replace(mean=force.mean + lane.disturbance)
        motor = None
        if lane.motor is not None:
            motor = (lane.motor.position, lane.motor.counts, jnp.full_like(lane.motor.position, lane.motor.noise))
        return lax.scan(body, (begin, spread), (lane.position, force, lane.load, motor))[1]

    gains, innovation, motor_innovation = lax.map(filter_lane, lanes)
    count, squares, logarithms = _sums(lanes.counts, innovation, gains.innovation_std)
    if lanes.motor is not None:
        motor = _sums(lanes.motor.counts, motor_innovation, gains.motor.innovation_std)
        count, squares, logarithms = count + motor[0], squares + motor[1], logarithms + motor[2]
    mean_square = squares / count
    deviance = count * jnp.log(mean_square) + 2.0 * logarithms
    return FilterResult(gains, innovation, deviance, motor_innovation)


def _sums(mask: Float[Array, "lanes n"], innovation: Float[Array, "lanes n"], std: Float[Array, "lanes n"]) -> Sums:
    """How many innovations count, their squares in standard deviations, and the logarithms of those."""
    return jnp.sum(mask), jnp.sum(mask * (innovation / std) ** 2), jnp.sum(mask * jnp.log(std))


@eqx.filter_jit
def _deviances(
    drive: Drive,
    delay: Scalar,
    processes: Float[Array, " p"],
    noise: Scalar,
    lanes: Lanes,
    sampling: Sampling,
    compliance: Scalar,
    between: BetweenRows,
) -> Float[Array, " p"]:
    def deviance(process: Scalar) -> Float[Array, ""]:
        return run_filter(drive, delay, process, noise, lanes, sampling, compliance, between).deviance

    return jax.vmap(deviance)(processes)


_run_filter = eqx.filter_jit(run_filter)


class MostLikely(NamedTuple):
    """The process force under which a log is likeliest, and what that says about the model."""

    process_force: float  # N, standard deviation of a white force, one value per control period
    deviance: float
    deviance_gain: (
        float  # how much smaller the deviance is than with no process force; above 10 or so the model lacks something
    )


def most_likely(
    drive: Drive,
    delay: Scalar,
    noise: float,
    lanes: Lanes,
    sampling: Sampling,
    compliance: Scalar = 0.0,
    between: BetweenRows = BetweenRows.HELD,
) -> MostLikely:
    """The likeliest of `PROCESS_FORCES`, as many at once as one vector of the processor holds.

    First the least and every third after it, then those around the best until it lies between two that are worse. The
    innovations' scale is free in the likelihood: only the ratio of process and measuring noise is at stake.
    """
    delay, noise_std, screw = (jnp.asarray(value) for value in (delay, noise, compliance))
    found, seen = np.full(len(PROCESS_FORCES), np.inf), np.zeros(len(PROCESS_FORCES), bool)
    some = APART * np.arange(WHOLE)
    while True:
        processes = jnp.asarray(PROCESS_FORCES[some])
        deviances = np.asarray(_deviances(drive, delay, processes, noise_std, lanes, sampling, screw, between))
        found[some], seen[some] = np.where(np.isfinite(deviances), deviances, np.inf), True
        best = int(np.argmin(found)) if np.isfinite(found).any() else len(found) - 1
        if seen[max(best - 1, 0) : best + 2].all():
            return MostLikely(float(PROCESS_FORCES[best]), float(found[best]), float(found[0] - found[best]))
        left = np.flatnonzero(~seen)
        some = np.resize(left[np.argsort(np.abs(left - best), kind="stable")], WHOLE)  # fewer are repeated


def filter_lanes(
    drive: Drive,
    delay: Scalar,
    process: float,
    noise: float,
    lanes: Lanes,
    sampling: Sampling,
    compliance: Scalar = 0.0,
    between: BetweenRows = BetweenRows.HELD,
) -> FilterResult:
    """Filter the lanes under a given process force (N)."""
    delay, process_force, noise_std = (jnp.asarray(value) for value in (delay, process, noise))
    return _run_filter(drive, delay, process_force, noise_std, lanes, sampling, jnp.asarray(compliance), between)
