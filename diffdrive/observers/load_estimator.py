"""Load estimators that sit on the paper's three-state observer."""

import dataclasses
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp

from diffdrive.model.quantity import quantity
from diffdrive.numerics.arrays import Scalar

GATE_ROUNDING = 0.1  # of the minimum speed, in the smooth variant


class FixedLoad(eqx.Module):
    """No estimator: the observer's load stays as it was set (the paper's PD+FC)."""

    load: Scalar = quantity("N", "the load that the observer assumes", default=0.0)

    suffix: ClassVar[str] = ""
    estimates_load: ClassVar[bool] = False
    gains: ClassVar[dict[str, str]] = {}

    def init(self) -> Scalar:
        return self.load

    def step(self, load: Scalar, velocity: Scalar, predicted: Scalar, updated: Scalar) -> Scalar:
        return load


class InnovationLoad(eqx.Module):
    """Eq. (20) as printed: What += sign(v) K_w (Fhat[k+1|k+1] - Fhat[k+1|k]).

    Two guards that the paper does not mention and that it cannot work without: no update below `min_speed`, and never
    below `floor`. It converges only where `convergence.convergence_gain` is positive: check that before using it.
    """

    gain: Scalar = quantity("1", "load estimator gain, K_w", at_least=0.0, default=100.0)
    min_speed: Scalar = quantity("m/s", "no update at or below this estimated speed", at_least=0.0, default=5e-3)
    floor: Scalar | None = quantity("N", "smallest load estimate; 'none': no floor", default=0.0, optional=True)
    rounding: Scalar | None = quantity(
        "m/s",
        "width over which the smooth variant opens the speed gate; absent: the exact switch",
        above=0.0,
        default=None,
    )
    initial_load: Scalar = quantity("N", "load estimate at the start", default=0.0)

    suffix: ClassVar[str] = "+le"
    estimates_load: ClassVar[bool] = True
    gains: ClassVar[dict[str, str]] = {"K_w": "gain"}

    def smoothed(self) -> "InnovationLoad":
        """The smooth variant: the speed gate opens over a width, and there is no floor."""
        rounding = GATE_ROUNDING * self.min_speed + 1e-9  # m/s, so that it is a width also without a gate
        return dataclasses.replace(self, floor=None, rounding=rounding)

    def init(self) -> Scalar:
        return self.initial_load

    def step(self, load: Scalar, velocity: Scalar, predicted: Scalar, updated: Scalar) -> Scalar:
        speed = jnp.abs(velocity)
        if self.rounding is None:
            gate = jnp.where(speed > self.min_speed, 1.0, 0.0)
        else:
            gate = jax.nn.sigmoid((speed - self.min_speed) / self.rounding)
        corrected = load + gate * jnp.sign(velocity) * self.gain * (updated - predicted)
        return corrected if self.floor is None else jnp.maximum(corrected, self.floor)
