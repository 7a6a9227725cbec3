"""What several readers need is computed once, not anew by each of them."""

from typing import TypeVar

import jax
from jax import lax

Values = TypeVar("Values")


def once(values: Values) -> Values:
    """The values as they are, behind a barrier through which a CPU's compiler does not look.

    XLA fuses a cheap operation into every kernel that reads its result. On a CPU most of a control step would so be
    computed several times (docs/evidence/performance.md says where that matters). On a GPU it is the other way round:
    one large kernel that computes things twice is faster than many that pass them on, so there the barrier is left
    out.
    """
    return lax.optimization_barrier(values) if jax.default_backend() == "cpu" else values
