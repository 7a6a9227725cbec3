"""Lanes of lengths that many logs share: a program is compiled for a length and serves all that are padded to it."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tuning.identification.prediction import Lanes


def rounded(count: int) -> int:
    """The next of lengths an eighth apart: logs of nearly the same length share their compiled programs."""
    step = max(1, 2 ** (int(count - 1).bit_length() - 4))
    return -(-count // step) * step


def padded(lanes: Lanes) -> Lanes:
    """The lanes with samples that do not count at their ends, up to a length that others share."""
    more = rounded(lanes.position.shape[1]) - lanes.position.shape[1]

    def longer(signal: Float[Array, "lanes n ..."], mode: str = "edge") -> Float[Array, "lanes m ..."]:
        return jnp.pad(signal, ((0, 0), (0, more), *((0, 0),) * (signal.ndim - 2)), mode=mode)

    motor = lanes.motor
    if motor is not None:
        motor = motor._replace(position=longer(motor.position), counts=longer(motor.counts, "constant"))
    signals = lanes._replace(velocity=None, counts=None, motor=None)  # type: ignore[arg-type]  # None is no leaf
    signals = jax.tree.map(longer, signals)
    return signals._replace(velocity=lanes.velocity, counts=longer(lanes.counts, "constant"), motor=motor)
