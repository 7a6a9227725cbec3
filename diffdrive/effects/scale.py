"""Effects on the measured position."""

from collections.abc import Mapping
from typing import ClassVar

import jax.numpy as jnp
import numpy as np

from diffdrive.effects.base import Envelope, ScaleEffect
from diffdrive.effects.forces import too_many_turns
from diffdrive.model.parameters import Drive
from diffdrive.model.quantity import quantity
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.trigonometry import cosine_sine, double_angle


def _counts_backwards(linear: Scalar, height: Scalar | np.ndarray, period: Scalar, envelope: Envelope) -> str | None:
    """Why a scale with a wave of this height (m) is impossible: its reading must increase with the position."""
    if not np.any(height > 0.0) and np.all(1.0 + np.asarray(linear) > 0.0):
        return None
    if problem := too_many_turns(envelope.farthest / np.asarray(period), "the way from 0 to the end of the stroke"):
        return problem
    slope = 1.0 + np.asarray(linear) - 2.0 * np.pi * height / np.asarray(period)
    if np.all(slope > 0.0):
        return None
    return (
        f"with it the scale counts {np.min(slope):.3g} m for each metre that the table moves: above 0 it must be "
        "everywhere; check the units"
    )


class LeadError(ScaleEffect):
    """Pitch error: periodic with the screw's lead, and linear.

    It lies between motor and table: where there is a motor encoder beside the scale, that one shows it, not the scale.
    """

    name: ClassVar[str] = "lead_error"
    from_sheet: ClassVar[Mapping[str, str]] = {"lead": "lead"}
    of_screw: ClassVar[bool] = True
    lead: Scalar = quantity("m", "lead of the screw", above=0.0, default=5e-3)
    cosine: Scalar = quantity("m", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("m", "amplitude of the sine", default=0.0)
    linear: Scalar = quantity("1", "error per travel", default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A scale that counts backwards."""
        return _counts_backwards(self.linear, np.hypot(self.cosine, self.sine), self.lead, envelope)

    def error(self, position: Scalar) -> Scalar:
        """The pitch error."""
        cosine, sine = cosine_sine(2.0 * jnp.pi * position / self.lead)
        return self.cosine * cosine + self.sine * sine + self.linear * position


class InterpolationError(ScaleEffect):
    """Sub-divisional error of the scale: first and second harmonic of its signal period."""

    name: ClassVar[str] = "interpolation_error"
    from_sheet: ClassVar[Mapping[str, str]] = {"period": "scale_period"}
    period: Scalar = quantity("m", "signal period of the scale", above=0.0, default=2e-5)
    cosine: Scalar = quantity("m", "amplitude of the cosine", default=0.0)
    sine: Scalar = quantity("m", "amplitude of the sine", default=0.0)
    cosine2: Scalar = quantity("m", "amplitude of the cosine of the second harmonic", default=0.0)
    sine2: Scalar = quantity("m", "amplitude of the sine of the second harmonic", default=0.0)

    def problem(self, drive: Drive, envelope: Envelope) -> str | None:
        """A scale that counts backwards."""
        height = np.hypot(self.cosine, self.sine) + 2.0 * np.hypot(self.cosine2, self.sine2)
        return _counts_backwards(0.0, height, self.period, envelope)

    def error(self, position: Scalar) -> Scalar:
        """The error within a signal period."""
        cosine, sine = cosine_sine(2.0 * jnp.pi * position / self.period)
        cosine2, sine2 = double_angle(cosine, sine)
        return self.cosine * cosine + self.sine * sine + self.cosine2 * cosine2 + self.sine2 * sine2
