"""A damped oscillator under a constant push, stepped exactly.

q'' + 2 zeta w q' + w^2 q = p
"""

from typing import NamedTuple

import jax.numpy as jnp

from diffdrive.parameters import Scalar


class Oscillator(NamedTuple):
    """Deflection q (m) and its rate (m/s)."""

    deflection: Scalar
    rate: Scalar

    @classmethod
    def at_rest(cls) -> "Oscillator":
        """Not deflected, at rest."""
        return cls(jnp.zeros(()), jnp.zeros(()))


def swing(state: Oscillator, push: Scalar, angular: Scalar, damping: Scalar, time: Scalar) -> Oscillator:
    """The state `time` (s) later under a constant `push` (m/s^2); `angular` in rad/s, damping ratio below 1."""
    ratio = jnp.minimum(damping, 0.999)
    turning, fading = angular * jnp.sqrt(1.0 - ratio**2), ratio * angular
    fade = jnp.exp(-fading * time)
    cosine, sine = fade * jnp.cos(turning * time), fade * jnp.sin(turning * time) / turning
    rest = push / angular**2
    from_rest = state.deflection - rest
    return Oscillator(
        rest + cosine * from_rest + sine * (state.rate + fading * from_rest),
        cosine * state.rate - sine * (fading * state.rate + angular**2 * from_rest),
    )
