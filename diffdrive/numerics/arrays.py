"""Numbers as JAX takes them: a scalar, a tree of arrays in double precision, or in that of another number."""

from typing import TYPE_CHECKING, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, PyTree

from diffdrive.errors import PrecisionError

if TYPE_CHECKING:
    Scalar = Float[Array, ""] | float | int
else:  # where hints are checked at run time: what is called for many at once takes an array over them, by broadcasting
    Scalar = Float[Array, "..."] | Float[np.ndarray, "..."] | Float[np.number, ""] | float | int
Tree = TypeVar("Tree")


def require_double_precision() -> None:
    """Raise `PrecisionError` unless JAX computes in double precision."""
    if not jax.config.jax_enable_x64:
        raise PrecisionError(
            "diffdrive needs double precision, which JAX leaves off by default: run "
            "`jax.config.update('jax_enable_x64', True)` before the first computation (the command line and "
            "`diffdrive.runtime.configure()` do it for you)"
        )


def as_arrays(tree: Tree) -> Tree:
    """The same tree with every number as a double-precision array, so that a new value never recompiles."""

    def convert(leaf: PyTree) -> PyTree:
        if isinstance(leaf, bool) or not isinstance(leaf, int | float | np.number | np.ndarray | jax.Array):
            return leaf
        return jnp.asarray(leaf, dtype=jnp.float64)

    return jax.tree.map(convert, tree)


def in_precision_of(number: Scalar, tree: Tree) -> Tree:
    """The same tree with every array of floats in the precision of `number`."""
    dtype = jnp.result_type(number)

    def convert(leaf: PyTree) -> PyTree:
        return leaf.astype(dtype) if isinstance(leaf, jax.Array) and jnp.issubdtype(leaf.dtype, jnp.floating) else leaf

    return jax.tree.map(convert, tree)
