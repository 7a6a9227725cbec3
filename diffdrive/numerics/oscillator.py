"""A damped oscillator under a constant push, stepped exactly.

q'' + 2 zeta w q' + w^2 q = p
"""

from typing import NamedTuple

import jax.numpy as jnp

from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.exponential import exp_neg
from diffdrive.numerics.trigonometry import cosine_sine

LARGEST_DAMPING = 1.0 - 1e-9  # ratio; effects declare it below 1, and a search that goes beyond finds no slope there


class Oscillator(NamedTuple):
    """Deflection q (m) and its rate (m/s)."""

    deflection: Scalar
    rate: Scalar

    @classmethod
    def at_rest(cls) -> "Oscillator":
        """Not deflected, at rest."""
        return cls(jnp.zeros(()), jnp.zeros(()))


class DiscreteOscillator(NamedTuple):
    """The exact discretisation of an oscillator, computed once for many steps."""

    cosine: Scalar  # both times the decay over the step
    sine: Scalar  # over its angular frequency, s
    decay_rate: Scalar  # 1/s
    frequency_squared: Scalar  # of the undamped angular frequency, 1/s^2
    compliance: Scalar  # its inverse

    def step(self, state: Oscillator, push: Scalar) -> Oscillator:
        """The state one step later under a constant `push` (m/s^2)."""
        equilibrium = push * self.compliance
        deviation = state.deflection - equilibrium
        return Oscillator(
            equilibrium + self.cosine * deviation + self.sine * (state.rate + self.decay_rate * deviation),
            self.cosine * state.rate - self.sine * (self.decay_rate * state.rate + self.frequency_squared * deviation),
        )


def discretise(angular: Scalar, damping: Scalar, time: Scalar) -> DiscreteOscillator:
    """The discretisation with steps of `time` (s); `angular` frequency in rad/s, `damping` ratio below 1."""
    ratio = jnp.minimum(damping, LARGEST_DAMPING)
    damped, decay_rate = angular * jnp.sqrt(1.0 - ratio**2), ratio * angular
    cosine, sine = cosine_sine(damped * time)
    decay = exp_neg(decay_rate * time)
    return DiscreteOscillator(decay * cosine, decay * sine / damped, decay_rate, angular**2, 1.0 / angular**2)
