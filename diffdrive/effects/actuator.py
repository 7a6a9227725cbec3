"""Effects between the command and the force."""

from typing import ClassVar

import jax.numpy as jnp
from jax import lax
from jaxtyping import PyTree

from diffdrive.effects.base import ActuatorEffect, Push, Stage, StaticActuatorEffect
from diffdrive.model.quantity import quantity
from diffdrive.numerics.arrays import Scalar

LONGEST_DELAY = 8  # control periods


class ForceGain(StaticActuatorEffect):
    """Another force constant than the drive file's."""

    name: ClassVar[str] = "force_gain"
    stage: ClassVar[Stage] = Stage.SCALED
    gain: Scalar = quantity("1", "force over the nominal force, minus one", above=-1.0, default=0.0)

    def input_limit(self, output_limit: Scalar | None) -> Scalar | None:
        """The limit before the gain."""
        return None if output_limit is None else output_limit / jnp.abs(1.0 + self.gain)

    def output(self, force: Scalar) -> Scalar:
        """The force scaled."""
        return (1.0 + self.gain) * force


class ForceLimit(StaticActuatorEffect):
    """Saturation of the amplifier below what the drive file says."""

    name: ClassVar[str] = "force_limit"
    stage: ClassVar[Stage] = Stage.LIMITED
    limit: Scalar = quantity("N", "largest force in either direction", above=0.0, default=float("inf"))

    def input_limit(self, output_limit: Scalar | None) -> Scalar | None:
        """Its own limit, or one behind it that is smaller."""
        return self.limit if output_limit is None else jnp.minimum(self.limit, output_limit)

    def output(self, force: Scalar) -> Scalar:
        """The force clipped."""
        return jnp.clip(force, -self.limit, self.limit)


class ActuatorLag(ActuatorEffect):
    """A current loop of finite bandwidth: a first-order lag, integrated exactly over the period."""

    name: ClassVar[str] = "actuator_lag"
    stage: ClassVar[Stage] = Stage.LAGGED
    time_constant: Scalar = quantity("s", "of the current loop, 1 / (2 pi bandwidth)", at_least=0.0, default=0.0)

    def init(self, force: Scalar) -> PyTree:
        """The force that acts."""
        return force

    def step(self, state: PyTree, force: Scalar, period: float) -> tuple[PyTree, Push]:
        """The force follows the request."""
        share = self.time_constant / period
        resolved = share > 1e-3
        decay = jnp.where(resolved, jnp.exp(-1.0 / jnp.where(resolved, share, 1.0)), 0.0)
        deviation, decayed = state - force, 1.0 - decay
        slope = -12.0 * deviation * share * (1.0 - (share + 0.5) * decayed)
        return force + deviation * decay, Push(force + deviation * share * decayed, slope)


class LoopDelay(ActuatorEffect):
    """Dead time anywhere in the loop; a log does not show where.

    A diagnosis may find a negative one: then the drive file's delay is too long. A whole number of periods is a corner:
    the derivative there is that towards longer delays, at the longest that towards shorter ones.
    """

    name: ClassVar[str] = "loop_delay"
    stage: ClassVar[Stage] = Stage.DELAYED
    delay: Scalar = quantity("1", "control periods", at_least=0.0, at_most=float(LONGEST_DELAY), default=0.0)

    def at_rate(self, share: float) -> "LoopDelay":
        """As many seconds, in the periods of that rate."""
        return LoopDelay(self.delay * share)

    def init(self, force: Scalar) -> PyTree:
        """Past forces, the latest first."""
        return (force,) * LONGEST_DELAY

    def step(self, state: PyTree, force: Scalar, period: float) -> tuple[PyTree, Push]:
        """The delayed force: one value, and from some instant within the period on the next."""
        forces = (force, *state)
        whole = lax.stop_gradient(jnp.clip(jnp.floor(self.delay), 0.0, LONGEST_DELAY - 1.0))
        # by comparison: a clip has half of the derivative at its ends
        part = jnp.where(self.delay < 0.0, 0.0, jnp.where(self.delay > LONGEST_DELAY, 1.0, self.delay - whole))
        latest, earlier = forces[-2:]
        for k in reversed(range(LONGEST_DELAY - 1)):
            latest = jnp.where(whole == k, forces[k], latest)
            earlier = jnp.where(whole == k, forces[k + 1], earlier)
        rest = 1.0 - part
        return forces[:-1], Push(rest * latest + part * earlier, 6.0 * part * rest * (latest - earlier))
