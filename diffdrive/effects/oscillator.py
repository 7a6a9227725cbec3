"""A damped oscillator under a constant push, stepped exactly.

q'' + 2 zeta w q' + w^2 q = p
"""

from typing import NamedTuple

import jax.numpy as jnp

from diffdrive.model.parameters import Scalar
from diffdrive.numerics.exponential import exp_neg
from diffdrive.numerics.trigonometry import cosine_sine


class Oscillator(NamedTuple):
    """Deflection q (m) and its rate (m/s)."""

    deflection: Scalar
    rate: Scalar

    @classmethod
    def at_rest(cls) -> "Oscillator":
        """Not deflected, at rest."""
        return cls(jnp.zeros(()), jnp.zeros(()))


class DiscreteOscillator(NamedTuple):
    """What a step of one oscillator needs, computed once for many steps."""

    cosine: Scalar  # both faded
    sine: Scalar  # over its angular frequency, s
    decay_rate: Scalar  # 1/s
    square: Scalar  # of the undamped angular frequency, 1/s^2
    softness: Scalar  # its inverse

    def step(self, state: Oscillator, push: Scalar) -> Oscillator:
        """The state one step later under a constant `push` (m/s^2)."""
        rest = push * self.softness
        from_rest = state.deflection - rest
        return Oscillator(
            rest + self.cosine * from_rest + self.sine * (state.rate + self.decay_rate * from_rest),
            self.cosine * state.rate - self.sine * (self.decay_rate * state.rate + self.square * from_rest),
        )


def discretise(angular: Scalar, damping: Scalar, time: Scalar) -> DiscreteOscillator:
    """Steps of `time` (s); `angular` in rad/s, damping ratio below 1."""
    ratio = jnp.minimum(damping, 0.999)
    turning, rate = angular * jnp.sqrt(1.0 - ratio**2), ratio * angular
    cosine, sine = cosine_sine(turning * time)
    fade = exp_neg(rate * time)
    return DiscreteOscillator(fade * cosine, fade * sine / turning, rate, angular**2, 1.0 / angular**2)
