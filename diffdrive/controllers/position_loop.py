"""What goes on around the gain of a position loop: delay and filter of its set-point, a slower cycle, held between."""

from typing import Annotated, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from diffdrive.controllers.filters import PT1
from diffdrive.model.memory import Memory
from diffdrive.numerics.arrays import Scalar
from diffdrive.numerics.pipeline import Pipeline, filled, pushed


class SetPoint(NamedTuple):
    """Past position set-points (m), oldest first, and the state of their filter; None where there is none."""

    past: Annotated[Pipeline, Memory("m", "past position set-points, oldest first")]
    lag: Annotated[Scalar | None, Memory("m", "state of the filter of the position set-point")]

    @classmethod
    def at(cls, position: Scalar, delay_samples: int, filter_time: Scalar | None) -> "SetPoint | None":
        """After a long time at this set-point (m); None where it is neither delayed nor filtered."""
        if filter_time is None and not delay_samples:
            return None
        return cls(filled(position, delay_samples), None if filter_time is None else position)

    def step(
        self, started: Scalar, position: Scalar, filter_time: Scalar | None, period: float
    ) -> tuple["SetPoint", Scalar]:
        """The state a `period` (s) later, and the set-point that the loop follows (m).

        Before the first sample, at which `started` is zero, it was where it is first given.
        """
        past, lag = jax.tree.map(lambda p: started * p + (1.0 - started) * position, self)
        position, past = pushed(past, position)
        if filter_time is not None:
            lag, position = PT1(filter_time).step(lag, position, period)
        return SetPoint(past, lag), position


class Held(NamedTuple):
    """The velocity set-point (m/s) of the last cycle of a position loop, and the samples until the next."""

    value: Annotated[Scalar, Memory("m/s", "velocity set-point of the last cycle of the position loop")]
    remaining: Annotated[Int[Array, ""], Memory("1", "samples until its next cycle")]

    @classmethod
    def at(cls, value: Scalar) -> "Held":
        """After a long time at this set-point (m/s), a new cycle being due."""
        return cls(value, jnp.zeros((), jnp.int32))

    def step(self, value: Scalar, every: int) -> tuple["Held", Scalar]:
        """The state a sample later, and what holds (m/s): a new `value` at every so many samples."""
        due = self.remaining == 0
        value = jnp.where(due, value, self.value)
        return Held(value, jnp.where(due, every - 1, self.remaining - 1)), value


class Averaged(NamedTuple):
    """The smooth variant of `Held`: the mean over the last cycle, which is what a hold is to a slow signal."""

    past: Annotated[Pipeline, Memory("m/s", "past velocity set-points, oldest first")]

    @classmethod
    def at(cls, value: Scalar, every: int) -> "Averaged":
        """After a long time at this set-point (m/s)."""
        return cls(filled(value, every - 1))

    def step(self, started: Scalar, value: Scalar, every: int) -> tuple["Averaged", Scalar]:
        """The state a sample later, and the mean (m/s)."""
        past = jax.tree.map(lambda p: started * p + (1.0 - started) * value, self.past)
        total = value + (sum(past) if isinstance(past, tuple) else jnp.sum(past))
        return Averaged(pushed(past, value)[1]), total / every
