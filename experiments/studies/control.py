"""The controllers of the machines that studies simulate, written out again: a PD, or a cascade."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from diffdrive.numerics.arrays import Scalar


class Control(NamedTuple):
    """A cascade, or a PD of the error with `kp` in N/m whose `ki` is zero and whose feed-forward is one."""

    cascaded: Scalar  # 1 or 0
    kp: Scalar  # 1/s, K_v
    kv: Scalar  # N s/m
    ki: Scalar = 0.0  # N/m
    feedforward: Scalar = 1.0  # share of the reference's speed

    def following_error(self, speed: float) -> float:
        """How far (m) the table is behind at a steady speed (m/s)."""
        return float(self.cascaded) * (1.0 - float(self.feedforward)) * abs(speed) / float(self.kp)


class Loop(NamedTuple):
    """What a controller remembers."""

    integral: Scalar  # N
    past: Float[Array, " samples"]  # m, measured, oldest first: the speed is a difference over so many samples


def command(
    control: Control, loop: Loop, reference: Scalar, speed: Scalar, measured: Scalar, period: Scalar
) -> tuple[Array, Loop]:
    """The command (N) of one sample; `speed` (m/s) is the reference's."""
    measured_speed = (measured - loop.past[0]) / (loop.past.shape[0] * period)
    missing = control.kp * (reference - measured)
    velocity_error = missing + control.feedforward * speed - measured_speed
    integral = loop.integral + control.ki * period * velocity_error
    cascade = control.kv * velocity_error + integral
    pd = missing + control.kv * (control.feedforward * speed - measured_speed)
    asked = jnp.where(jnp.asarray(control.cascaded) > 0.0, cascade, pd)
    return asked, Loop(integral, jnp.append(loop.past[1:], measured))
