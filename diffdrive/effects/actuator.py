"""Effects between the command and the force."""

from typing import Any, ClassVar

import jax.numpy as jnp

from diffdrive.effects.base import ActuatorEffect
from diffdrive.parameters import Scalar, quantity

LONGEST_DELAY = 8  # control periods


class ForceGain(ActuatorEffect):
    """Another force constant than the drive file's."""

    name: ClassVar[str] = "force_gain"
    gain: Scalar = quantity("1", "force over the force believed, minus one", default=0.0)

    def init(self, force: Scalar) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Scalar]:
        """The force scaled."""
        return state, (1.0 + self.gain) * force


class ForceLimit(ActuatorEffect):
    """Saturation of the amplifier below what the drive file says."""

    name: ClassVar[str] = "force_limit"
    limit: Scalar = quantity("N", "largest force in either direction", above=0.0, default=float("inf"))

    def init(self, force: Scalar) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Scalar]:
        """The force clipped."""
        return state, jnp.clip(force, -self.limit, self.limit)


class ActuatorLag(ActuatorEffect):
    """A current loop of finite bandwidth: a first-order lag, integrated exactly over the period."""

    name: ClassVar[str] = "actuator_lag"
    time_constant: Scalar = quantity("s", "of the current loop, 1 / (2 pi bandwidth)", at_least=0.0, default=0.0)

    def init(self, force: Scalar) -> Any:
        """The force that acts."""
        return force

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Scalar]:
        """The force follows what is asked for."""
        share = self.time_constant / period
        there = share > 1e-3
        fade = jnp.where(there, jnp.exp(-1.0 / jnp.where(there, share, 1.0)), 0.0)
        return force + (state - force) * fade, force + (state - force) * share * (1.0 - fade)


class LoopDelay(ActuatorEffect):
    """Dead time anywhere in the loop; a log does not tell where."""

    name: ClassVar[str] = "loop_delay"
    delay: Scalar = quantity("1", "control periods", at_least=0.0, default=0.0)

    def init(self, force: Scalar) -> Any:
        """Forces on their way, the latest first."""
        return (force,) * LONGEST_DELAY

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Scalar]:
        """The mean of what arrives over the period: linear between whole periods."""
        forces = (force, *state)
        late = [jnp.clip(1.0 - jnp.abs(self.delay - k), 0.0, 1.0) for k in range(LONGEST_DELAY + 1)]
        return forces[:-1], sum(share * one for share, one in zip(late, forces, strict=True))
