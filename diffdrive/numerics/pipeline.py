"""Delay lines of a fixed number of samples: for delays, and for differences over several samples.

A short one is a tuple of numbers, which the compiler keeps in registers. A long tuple would take minutes to compile
(the time grows with the square of the length, 17 s for a thousand), so a long one is an array, shifted by one.
"""

from collections.abc import Iterable

import jax
import jax.numpy as jnp

from diffdrive.errors import ParameterError
from diffdrive.numerics.arrays import Scalar
from diffdrive.support.resources import format_count

LONGEST_TUPLE = 32  # up to here compiling takes no longer than without

Pipeline = tuple[Scalar, ...] | jax.Array  # [n], next to come out first


def filled(value: Scalar, count: int) -> Pipeline:
    """`count` times the same value."""
    return (value,) * count if count <= LONGEST_TUPLE else jnp.broadcast_to(value, (count,))


def pushed(pipeline: Pipeline, value: Scalar) -> tuple[Scalar, Pipeline]:
    """The value that comes out as `value` goes in, and the pipeline after that."""
    if isinstance(pipeline, tuple):
        value_out, *rest = (*pipeline, value)
        return value_out, tuple(rest)
    return pipeline[0], jnp.concatenate([pipeline[1:], jnp.reshape(value, (1,)).astype(pipeline.dtype)])


def require_shorter(samples: int, names: Iterable[tuple[str, int]]) -> None:
    """Raise `ParameterError` for a pipeline (its name and length) through which nothing comes in so many samples."""
    for name, length in names:
        if length >= samples:
            raise ParameterError(
                f"{name} of {format_count(length)} samples is as long as the motion of "
                f"{samples} samples: nothing comes out of it before the end; shorten it"
            )
