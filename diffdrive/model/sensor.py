"""Position to measured position: white noise, then the resolution of the scale."""

import jax.numpy as jnp
from jax import lax

from diffdrive.model.parameters import Sensor
from diffdrive.numerics.arrays import Scalar


def quantise(position: Scalar, resolution: Scalar) -> Scalar:
    """The position rounded to the resolution, with the straight-through derivative (that of no quantiser).

    The true derivative is zero almost everywhere, which would cut the feedback loop out of every gradient.
    """
    step = resolution * jnp.round(position / resolution)
    return position + lax.stop_gradient(step - position)


def measure(sensor: Sensor, position: Scalar, normal: Scalar | None) -> Scalar:
    """Measured position; `normal` is a standard normal number, or None for no noise at all."""
    if normal is not None:
        position = position + sensor.noise * normal
    return position if sensor.resolution is None else quantise(position, sensor.resolution)
