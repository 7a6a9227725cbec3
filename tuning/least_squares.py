"""Levenberg-Marquardt, one step at a time, so that it can show its progress and always returns the best it has seen."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from diffdrive.errors import DivergenceError

Progress = Callable[[int, int, float], None]


def silent(step: int, most: int, cost: float) -> None:
    """Show nothing."""


@dataclass(frozen=True)
class Search:
    """Where a search ended: the best point, why it stopped, and the root of the sum of squares along the way."""

    y: np.ndarray
    status: str
    cost_before: float
    cost: float
    steps: int
    seconds: float
    history: list[float]


def levenberg_marquardt(
    residuals: Callable[[Float[Array, " k"], Any], Float[Array, " m"]],
    y: Float[np.ndarray, " k"],
    args: Any,
    *,
    max_steps: int,
    tolerance: float,
    progress: Progress = silent,
) -> Search:
    """Minimise the sum of squares of `residuals(y, args)` from `y`.

    Stops when a step changes neither cost nor point by more than `tolerance`, after `max_steps`, or when interrupted
    (Ctrl-C), and returns the best point seen in any case. The Jacobian is forward-mode: it costs about twice a
    simulation with a handful of parameters, and no memory. Raises `DivergenceError` if the start itself has no finite
    cost.
    """

    def fn(y: Any, args: Any) -> tuple[Any, None]:
        return residuals(y, args), None

    began = time.perf_counter()
    solver = optx.LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    point = jnp.asarray(y)
    options: dict[str, Any] = {"jac": "fwd"}
    tags: frozenset[object] = frozenset()
    first = float(jnp.linalg.norm(eqx.filter_jit(residuals)(point, args)))
    if not np.isfinite(first):
        raise DivergenceError(
            "the loop diverges where the search starts: start from values with which `simulate` is ok"
        )
    state = solver.init(fn, point, args, options, *eqx.filter_eval_shape(fn, point, args), tags)
    step = eqx.filter_jit(lambda y, args, state: solver.step(fn, y, args, options, state, tags))
    done = eqx.filter_jit(lambda y, args, state: solver.terminate(fn, y, args, options, state, tags))
    best, cost, history = point, first, [first]
    status, count = f"stopped after {max_steps} steps, still falling", 0
    try:
        for count in range(1, max_steps + 1):
            point, state, _ = step(point, args, state)
            now = float(jnp.sqrt(2.0 * state.f_info.as_min()))
            history.append(now)
            if np.isfinite(now) and now < cost:
                best, cost = point, now
            progress(count, max_steps, cost)
            finished, result = done(point, args, state)
            if bool(finished):
                status = "converged" if bool(result == optx.RESULTS.successful) else f"stopped: {result}"
                break
    except KeyboardInterrupt:
        status = f"interrupted after {count - 1} steps"
    return Search(np.asarray(best), status, first, cost, count, time.perf_counter() - began, history)
