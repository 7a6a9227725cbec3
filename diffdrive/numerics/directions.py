"""Derivatives in many directions side by side, in whole vectors of the processor."""

from collections.abc import Callable
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, PyTree

WHOLE = 8  # doubles in the widest registers of a processor (AVX-512); a multiple of those of all others


def along_each(
    function: Callable[[Float[Array, " k"]], PyTree], at: Float[Array, " k"], axis: Literal[0, 1]
) -> tuple[PyTree, PyTree]:
    """The value of `function` and its derivative by each number of `at`, in forward mode and one pass.

    The derivatives of an array are stacked along `axis`. A loop over an odd number of lanes does the last few one by
    one: 13 of them take twice as long as 16. So they are filled up to a multiple of eight with directions that lead
    nowhere, whose derivatives are dropped.

    Examples:
        >>> from diffdrive.numerics.directions import along_each
        >>> import jax.numpy as jnp
        >>> value, columns = along_each(lambda x: x**2, jnp.arange(3.0), axis=1)
        >>> columns.diagonal().tolist()
        [0.0, 2.0, 4.0]

    """
    size = len(at)

    def along(direction: Float[Array, " k"]) -> tuple[PyTree, PyTree]:
        return jax.jvp(function, (at,), (direction,))

    ways = jnp.eye(-(-size // WHOLE) * WHOLE, size)
    value, columns = jax.vmap(along, out_axes=(None, axis))(ways)
    return value, jax.tree.map(lambda leaf: leaf[(slice(None),) * axis + (slice(size),)], columns)
