"""What the encoders of an axis read: the scale at the table, and the motor's where there is one.

With both, each has its own errors: pitch errors and the deflection of the screw lie between them, and show on the
motor's. With the scale alone, it shows all errors of the measured position, as the one encoder of an axis does.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Integer, PyTree

from diffdrive.controllers import Encoders
from diffdrive.effects import stages
from diffdrive.model import sensor
from diffdrive.model.parameters import Drive
from diffdrive.numerics.arrays import Scalar, in_precision_of

Count = Integer[Array, ""] | int

MOTOR = 1  # folded into a sample's key: the noise of the motor encoder is independent of the scale's


def read_encoders(
    drive: Drive, position: Scalar, effect_states: tuple[PyTree, ...], key: Array | None = None, count: Count = 0
) -> Encoders:
    """The readings (m) where the table is at `position` (m), at sample `count`; `key` seeds the noise (None: none)."""
    effects = drive.effects if drive.motor_encoder is None else stages.of_scale(drive.effects)
    scale_position = position + stages.scale_error(effects, position)
    sample_key = None if key is None else jax.random.fold_in(key, count)
    scale = sensor.measure(drive.sensor, scale_position, _normal(sample_key, scale_position))
    if drive.motor_encoder is None:
        return Encoders(scale)
    deflection = stages.motor_deflection(drive.effects, effect_states)
    motor_position = position + deflection + stages.scale_error(stages.of_screw(drive.effects), position)
    motor_key = None if sample_key is None else jax.random.fold_in(sample_key, MOTOR)
    return Encoders(scale, sensor.measure(drive.motor_encoder, motor_position, _normal(motor_key, motor_position)))


def _normal(key: Array | None, position: Scalar) -> Scalar | None:
    """A standard normal number, the same in either precision."""
    return None if key is None else in_precision_of(position, jax.random.normal(key, dtype=jnp.float64))
