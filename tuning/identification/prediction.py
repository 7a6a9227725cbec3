"""One-step prediction of a log by a drive: what the model did not foresee, sample by sample.

The drive is given the command that the log holds, so that the noise in the machine's loop reaches it too, and at each
sample is corrected by the innovation, e = measured minus predicted position:

    x <- x + Kx e ,   v <- v + Kv e ,   z <- z + Kz e

An open-loop replay of the command (K = 0) is of no use for a drive with a falling Stribeck curve: there the motion is
unstable, and a micrometre becomes a millimetre. `constant_gains` pulls with one bandwidth throughout, which is robust
but lets the noise in; the gains of `tuning.identification.filter_gain` pull as hard as the model is trusted and the
measurement is good (the innovation form of the prediction-error method: Ljung, System Identification, ch. 7).

Where the log has the motor's encoder beside the scale, the drive is corrected by both, one after the other: their
noises are independent, so that this is the correction by both at once (Anderson and Moore, Optimal Filtering, 6.2).
"""

from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.model import plant
from diffdrive.model.friction import stribeck_level
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar, require_double_precision
from diffdrive.numerics.once import once
from tuning.identification.row_force import BetweenRows, advance, applied_force

INITIAL_WINDOW, MIN_WINDOW_SAMPLES = (
    5e-3,
    5,
)  # s, and samples at least, in which the velocity at the first sample is measured


class MotorReadings(NamedTuple):
    """The motor encoder of the lanes, read as the table's position but for the wind-up of the screw."""

    position: Float[Array, "lanes n"]  # m
    counts: Float[Array, "lanes n"]  # 0 where it was not measured
    noise: Float[Array, " lanes"]  # m, standard deviation
    leads: Float[Array, " lanes"]  # 1 where it is finer than the scale


class Lanes(NamedTuple):
    """Stretches of logs side by side, [lanes, n] each; shorter ones are padded at the end, where `counts` is 0."""

    position: Float[Array, "lanes n"]  # m
    command: Float[Array, "lanes n"]  # N
    disturbance: Float[Array, "lanes n"]  # N
    load: Float[Array, "lanes n"]  # N
    counts: Float[Array, "lanes n"]
    velocity: Float[Array, " lanes"]  # m/s, at the first sample
    period_commands: Float[Array, "lanes n k"] | None = (
        None  # N, the command of each control period where a sample has several
    )
    motor: MotorReadings | None = None  # beside the scale

    @property
    def lanes(self) -> int:
        """How many."""
        return self.position.shape[0]

    @property
    def encoders(self) -> int:
        """How many encoders are read at each sample."""
        return 1 if self.motor is None else 2


class Corrections(NamedTuple):
    """Those of the motor encoder: per metre of innovation, and how far that is expected to scatter; [lanes, n] each."""

    position: Float[Array, "lanes n"]  # 1
    velocity: Float[Array, "lanes n"]  # 1/s
    bristle: Float[Array, "lanes n"]  # 1
    innovation_std: Float[Array, "lanes n"]  # m


class FilterGains(NamedTuple):
    """Corrections per metre of innovation, and how far the innovation is expected to scatter; [lanes, n] each."""

    position: Float[Array, "lanes n"]  # 1
    velocity: Float[Array, "lanes n"]  # 1/s
    bristle: Float[Array, "lanes n"]  # 1
    innovation_std: Float[Array, "lanes n"]  # m
    motor: Corrections | None = None  # where the lanes have its readings, the corrections after those above


def constant_gains(bandwidth: float, noise: float, lanes: Lanes, period: float) -> FilterGains:
    """Gains that put both poles of a free mass at exp(-bandwidth T), bandwidth in rad/s; the bristle is left alone."""
    pole = float(np.exp(-bandwidth * period))
    values = (1.0 - pole**2, (1.0 - pole) ** 2 / period, 0.0, noise)
    scale = Corrections(*(jnp.full(lanes.position.shape, value) for value in values))
    if lanes.motor is None:
        return FilterGains(*scale)
    leads = lanes.motor.counts * lanes.motor.leads[:, None]  # the finer encoder corrects alone
    motor = Corrections(*(leads * gain for gain in scale))._replace(
        position=leads * scale.position.at[:, 0].set(1.0),  # it begins where the finer one says
        innovation_std=jnp.broadcast_to(lanes.motor.noise[:, None], leads.shape),
    )
    position, velocity, bristle = ((1.0 - leads) * gain for gain in scale[:3])
    return FilterGains(position, velocity, bristle, scale.innovation_std, motor)


def initial_velocity(position: Float[Array, "*s n"], rate: float) -> Float[Array, "*s"]:
    """Velocity (m/s) at the first sample: that of the parabola through the first few.

    A straight line would give the velocity in their middle, which at 10 m/s^2 is 25 mm/s off: a filter that begins with
    that is lost, and stays so.
    """
    few = min(max(MIN_WINDOW_SAMPLES, round(INITIAL_WINDOW * rate)), position.shape[-1])
    powers = np.vander(np.arange(few) / rate, 3, increasing=True)
    return (position[..., :few] - position[..., :1]) @ jnp.asarray(np.linalg.pinv(powers)[1])


def initial_state(drive: Drive, lane: Lanes) -> plant.PlantState:
    """Where one lane begins: where it is measured, at its velocity, the bristle bent as that velocity bends it."""
    stiffness = drive.friction.bristle_stiffness.towards(lane.velocity)
    bent = stribeck_level(drive.friction, lane.velocity, lane.load[0]) / stiffness
    return plant.PlantState(lane.position[0], lane.velocity, bent * jnp.tanh(lane.velocity / SLIDING))


SLIDING = 1e-3  # m/s; well above it the bristle is taken as bent, well below as relaxed


class Prediction(NamedTuple):
    """What was predicted, [lanes, n] each."""

    innovation: Float[Array, "lanes n"]  # m
    velocity: Float[Array, "lanes n"]  # m/s, after the correction
    motor_innovation: Float[Array, "lanes n"] | None = None  # m, after the correction by the scale


def wind_up(drive: Drive, compliance: Scalar, bristle: Scalar) -> tuple[Scalar, Scalar]:
    """How far the motor is ahead of the table (m) where friction bends the bristle so, and its derivative by that.

    The screw carries the friction of the table, of which that of the bristle changes in reversals; the viscous one and
    the inertia are taken off the readings (tuning.identification.motor_encoder).
    """
    per_bristle = compliance * drive.friction.bristle_stiffness.towards(bristle)
    return per_bristle * bristle, per_bristle


def corrected(state: plant.PlantState, gains: Sequence[Scalar], innovation: Scalar) -> plant.PlantState:
    """The state after a measurement."""
    return plant.PlantState(*(value + gain * innovation for value, gain in zip(state, gains, strict=True)))


def predict(
    drive: Drive,
    delay: Scalar,
    gains: FilterGains,
    lanes: Lanes,
    sampling: Sampling,
    compliance: Scalar = 0.0,
    between: BetweenRows = BetweenRows.HELD,
) -> Prediction:
    """Predict each lane. Pure: for use under `jit`, `vmap` and `jacfwd`.

    `delay` (control periods) stands for the drive's own; `compliance` (m/N) is the wind-up of the screw per newton of
    friction, which the readings of a motor encoder hold. `between` says what the command does between rows.
    """
    require_double_precision()

    def body(state: plant.PlantState, sample: tuple[PyTree, ...]) -> tuple[plant.PlantState, Prediction]:
        measured, force, load, pull, motor = sample
        innovation = measured - state.position
        state = corrected(state, pull, innovation)
        motor_innovation = None
        if motor is not None:
            reading, motor_pull = motor
            motor_innovation = reading - state.position - wind_up(drive, compliance, state.bristle)[0]
            state = corrected(state, motor_pull, motor_innovation)
        state = once(state)
        ahead = advance(drive, state, force, load, sampling)
        return ahead, Prediction(innovation, jnp.asarray(state.velocity), motor_innovation)

    def predict_lane(lane: Lanes, gains: FilterGains) -> Prediction:
        force = applied_force(drive.actuator, lane.command, delay, sampling.period, between)
        force = force._replace(mean=force.mean + lane.disturbance)
        motor = None
        if lane.motor is not None:
            assert gains.motor is not None
            motor = (lane.motor.position, gains.motor[:3])
        return lax.scan(body, initial_state(drive, lane), (lane.position, force, lane.load, gains[:3], motor))[1]

    # one lane after the other: batched derivatives then lie side by side in memory, which is four times faster
    return lax.map(lambda pair: predict_lane(*pair), (lanes, gains))
