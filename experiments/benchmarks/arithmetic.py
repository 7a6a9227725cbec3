"""How much arithmetic a control step is, counted in its own expression: what its cost should be in proportion to."""

from typing import Any

import jax
import jax.numpy as jnp

from diffdrive.controllers import Controller, Reference
from diffdrive.loop.simulate import Inputs, initial_state, step
from diffdrive.model.parameters import Drive, Sampling, as_arrays

DEAR = {"div": 8, "sqrt": 10, "exp": 12, "sin": 20, "cos": 20, "tanh": 20, "logistic": 16, "pow": 30}  # in vectors
FREE = {
    "broadcast_in_dim", "convert_element_type", "reshape", "squeeze", "copy", "optimization_barrier", "stop_gradient",
    "bitcast_convert_type", "slice", "dynamic_slice", "concatenate", "iota", "pjit", "copy_p",
}  # fmt: skip


def _inner(equation: Any) -> list[tuple[Any, int]]:
    """The expressions within one, and how often each runs."""
    times = int(equation.params.get("length", 1)) if equation.primitive.name == "scan" else 1
    found = []
    for value in equation.params.values():
        for one in value if isinstance(value, tuple | list) else (value,):
            inner = getattr(one, "jaxpr", one)
            if hasattr(inner, "eqns"):
                found.append((inner, times))
    return found


def operations(jaxpr: Any) -> int:
    """Additions, products, comparisons and selections; a division or a root counts as several."""
    total = 0
    for equation in jaxpr.eqns:
        inner = _inner(equation)
        if inner:
            total += sum(times * operations(one) for one, times in inner)
        elif equation.primitive.name not in FREE:
            total += DEAR.get(equation.primitive.name, 1)
    return total


def of_step(drive: Drive, controller: Controller, sampling: Sampling) -> int:
    """Operations of one control step of the closed loop."""
    machine, control = as_arrays((drive, controller))
    zero = jnp.zeros(())
    begin = initial_state(machine, control, zero)
    inputs = Inputs(Reference(zero, zero, zero), zero, zero)
    traced = jax.make_jaxpr(lambda state, given: step(machine, control, sampling, None, state, given))
    return operations(traced(begin, inputs).jaxpr)
