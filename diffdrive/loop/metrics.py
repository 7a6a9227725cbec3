"""How well the table follows: scalars of a tracking error, safe to differentiate."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.errors import ParameterError
from diffdrive.numerics.arrays import Scalar


def window(time: np.ndarray, start: float, end: float) -> slice:
    """The samples of `time` (s, rising) in [`start`, `end`]; raises `ParameterError` if there is none."""
    inside = np.flatnonzero((time >= start - 1e-9) & (time <= end + 1e-9))
    if not len(inside):
        raise ParameterError(f"no sample between {start:g} and {end:g} s: the run lasts {time[0]:g} to {time[-1]:g} s")
    return slice(int(inside[0]), int(inside[-1]) + 1)


def safe_sqrt(value: Scalar) -> Array:
    """Square root whose derivative at zero is zero, not infinite."""
    above = value > 0
    return jnp.where(above, jnp.sqrt(jnp.where(above, value, 1.0)), 0.0 * value)


def rms(signal: Float[Array, "*lanes n"]) -> Float[Array, "*lanes"]:
    """Root mean square over time; where the signal is zero throughout, its gradient is zero, not NaN."""
    return safe_sqrt(jnp.mean(signal**2, axis=-1))


def command_noise(command: Float[Array, "*lanes n"] | Float[np.ndarray, "*lanes n"]) -> Float[Array, "*lanes"]:
    """RMS of the sample-to-sample change over sqrt 2: the standard deviation of a white command noise, N."""
    return rms(jnp.diff(command)) / jnp.sqrt(2.0)
