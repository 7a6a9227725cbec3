"""Effects between the command and the force."""

from typing import Any, ClassVar

import jax.numpy as jnp

from diffdrive.effects.base import ActuatorEffect, Push, Stage
from diffdrive.model.parameters import Scalar, quantity

LONGEST_DELAY = 8  # control periods


class ForceGain(ActuatorEffect):
    """Another force constant than the drive file's."""

    name: ClassVar[str] = "force_gain"
    stage: ClassVar[Stage] = Stage.SCALED
    gain: Scalar = quantity("1", "force over the force believed, minus one", above=-1.0, default=0.0)

    def init(self, force: Scalar) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Push]:
        """The force scaled."""
        return state, Push((1.0 + self.gain) * force)


class ForceLimit(ActuatorEffect):
    """Saturation of the amplifier below what the drive file says."""

    name: ClassVar[str] = "force_limit"
    stage: ClassVar[Stage] = Stage.LIMITED
    limit: Scalar = quantity("N", "largest force in either direction", above=0.0, default=float("inf"))

    def init(self, force: Scalar) -> Any:
        """Nothing is carried."""
        return ()

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Push]:
        """The force clipped."""
        return state, Push(jnp.clip(force, -self.limit, self.limit))


class ActuatorLag(ActuatorEffect):
    """A current loop of finite bandwidth: a first-order lag, integrated exactly over the period."""

    name: ClassVar[str] = "actuator_lag"
    stage: ClassVar[Stage] = Stage.LAGGED
    time_constant: Scalar = quantity("s", "of the current loop, 1 / (2 pi bandwidth)", at_least=0.0, default=0.0)

    def init(self, force: Scalar) -> Any:
        """The force that acts."""
        return force

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Push]:
        """The force follows what is asked for."""
        share = self.time_constant / period
        there = share > 1e-3
        fade = jnp.where(there, jnp.exp(-1.0 / jnp.where(there, share, 1.0)), 0.0)
        apart, gone = state - force, 1.0 - fade
        tilt = -12.0 * apart * share * (1.0 - (share + 0.5) * gone)
        return force + apart * fade, Push(force + apart * share * gone, tilt)


class LoopDelay(ActuatorEffect):
    """Dead time anywhere in the loop; a log does not tell where.

    A diagnosis may find less than none: then it is the drive file that claims too much.
    """

    name: ClassVar[str] = "loop_delay"
    stage: ClassVar[Stage] = Stage.DELAYED
    delay: Scalar = quantity("1", "control periods", at_least=0.0, at_most=float(LONGEST_DELAY), default=0.0)

    def init(self, force: Scalar) -> Any:
        """Forces on their way, the latest first."""
        return (force,) * LONGEST_DELAY

    def step(self, state: Any, force: Scalar, period: float) -> tuple[Any, Push]:
        """What arrives over the period: one force, and from somewhere within the period the next."""
        forces = (force, *state)
        late = jnp.clip(self.delay, 0.0, LONGEST_DELAY)
        shares = [jnp.clip(1.0 - jnp.abs(late - k), 0.0, 1.0) for k in range(LONGEST_DELAY + 1)]
        steps = [shares[k] * shares[k + 1] * (forces[k] - forces[k + 1]) for k in range(LONGEST_DELAY)]
        mean = sum(share * one for share, one in zip(shares, forces, strict=True))
        return forces[:-1], Push(mean, 6.0 * sum(steps))
