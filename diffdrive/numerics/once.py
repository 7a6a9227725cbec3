"""A value that several operations read is computed once, not again for each of them."""

from typing import TypeVar

import jax
from jax import lax

Values = TypeVar("Values")


def once(values: Values) -> Values:
    """The values unchanged, behind an optimisation barrier on a CPU.

    XLA fuses a cheap operation into every kernel that reads its result. On a CPU most of a control step would then be
    computed several times (docs/evidence/performance.md says where that matters). On a GPU one large kernel that
    computes things twice is faster than many that pass them on, so there is no barrier.
    """
    if jax.default_backend() != "cpu":
        return values
    return lax.optimization_barrier(values)  # type: ignore[no-untyped-call]  # jax declares no types of it
