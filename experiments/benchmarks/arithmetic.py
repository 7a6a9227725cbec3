"""The arithmetic of a control step, counted in its jaxpr: its cost should be in proportion."""

from typing import cast

import jax
import jax.numpy as jnp
from jax.extend.core import Jaxpr, JaxprEqn

from diffdrive.controllers import Controller, Reference
from diffdrive.loop.step import Inputs, initial_state, step
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import as_arrays

WEIGHTS = {"div": 8, "sqrt": 10, "exp": 12, "sin": 20, "cos": 20, "tanh": 20, "logistic": 16, "pow": 30}  # in vectors
FREE = {
    "broadcast_in_dim", "convert_element_type", "reshape", "squeeze", "copy", "optimization_barrier", "stop_gradient",
    "bitcast_convert_type", "slice", "dynamic_slice", "concatenate", "iota", "pjit", "copy_p",
}  # fmt: skip


def _inner(equation: JaxprEqn) -> list[tuple[Jaxpr, int]]:
    """The jaxprs within an equation, and how often each runs."""
    times = int(equation.params.get("length", 1)) if equation.primitive.name == "scan" else 1
    inner_jaxprs: list[tuple[Jaxpr, int]] = []
    for value in equation.params.values():
        for item in value if isinstance(value, tuple | list) else (value,):
            inner = getattr(item, "jaxpr", item)
            if hasattr(inner, "eqns"):
                inner_jaxprs.append((cast(Jaxpr, inner), times))
    return inner_jaxprs


def operations(jaxpr: Jaxpr) -> int:
    """Additions, products, comparisons and selections; a division or a root counts as several."""
    total = 0
    for equation in jaxpr.eqns:
        inner = _inner(equation)
        if inner:
            total += sum(times * operations(inner_jaxpr) for inner_jaxpr, times in inner)
        elif equation.primitive.name not in FREE:
            total += WEIGHTS.get(equation.primitive.name, 1)
    return total


def step_operations(drive: Drive, controller: Controller, sampling: Sampling) -> int:
    """Operations of one control step of the closed loop."""
    machine, control = as_arrays((drive, controller))
    zero = jnp.zeros(())
    initial = initial_state(machine, control, zero)
    inputs = Inputs(Reference(zero, zero, zero), zero, zero)
    traced = jax.make_jaxpr(lambda state, inputs: step(machine, control, sampling, None, state, inputs))
    return operations(traced(initial, inputs).jaxpr)
