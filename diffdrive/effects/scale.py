"""Effects on the measured position."""

from typing import ClassVar

import jax.numpy as jnp

from diffdrive.effects.base import ScaleEffect
from diffdrive.parameters import Scalar, quantity
from diffdrive.turning import cosine_sine, doubled


class LeadError(ScaleEffect):
    """Pitch error: periodic with the screw's lead, and linear."""

    name: ClassVar[str] = "lead_error"
    lead: Scalar = quantity("m", "lead of the screw", above=0.0, default=5e-3)
    cosine: Scalar = quantity("m", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("m", "amplitude of the sine", default=0.0)
    linear: Scalar = quantity("1", "error per travel", default=0.0)

    def error(self, position: Scalar) -> Scalar:
        """The pitch error."""
        cosine, sine = cosine_sine(2.0 * jnp.pi * position / self.lead)
        return self.cosine * cosine + self.sine * sine + self.linear * position


class InterpolationError(ScaleEffect):
    """Sub-divisional error of the scale: first and second harmonic of its signal period."""

    name: ClassVar[str] = "interpolation_error"
    period: Scalar = quantity("m", "signal period of the scale", above=0.0, default=2e-5)
    cosine: Scalar = quantity("m", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("m", "amplitude of the sine", default=0.0)
    cosine2: Scalar = quantity("m", "amplitude of the cosine of the second harmonic", default=0.0)
    sine2: Scalar = quantity("m", "amplitude of the sine of the second harmonic", default=0.0)

    def error(self, position: Scalar) -> Scalar:
        """The error within a signal period."""
        cosine, sine = cosine_sine(2.0 * jnp.pi * position / self.period)
        cosine2, sine2 = doubled(cosine, sine)
        return self.cosine * cosine + self.sine * sine + self.cosine2 * cosine2 + self.sine2 * sine2
