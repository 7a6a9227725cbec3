"""Levenberg-Marquardt, one step at a time, so that it can show its progress and always returns the best it has seen.

From one start, or from many in one vmapped program.
"""

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from diffdrive.errors import DivergenceError

Progress = Callable[[int, int, float], None]
Residuals = Callable[[Float[Array, " k"], Any], Float[Array, " m"]]


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


class _LevenbergMarquardt(optx.AbstractGaussNewton):
    """optimistix's, but its damping falls eightfold after each step that goes at least half as well as foreseen.

    The stock one waits for steps that go 99 % as well, which a simulation of friction hardly ever grants.
    """

    rtol: float
    atol: float
    norm: Callable[[Any], Any] = optx.max_norm
    descent: optx.DampedNewtonDescent = optx.DampedNewtonDescent(linear_solver=lx.QR())
    search: optx.ClassicalTrustRegion = optx.ClassicalTrustRegion(
        high_cutoff=0.5, low_cutoff=0.01, high_constant=8.0, low_constant=0.2
    )
    verbose: Callable[..., None] = eqx.field(static=True, default=lambda **_: None)


START_NORM = 10.0  # the residuals are scaled to it at the start, so that the first damping of 1 is a light one


def with_jacobian(residuals: Residuals) -> Residuals:
    """The same residuals, whose derivative is one forward pass for all parameters at once, alongside the value.

    A solver that linearises them keeps the Jacobian, [m, k], in place of every intermediate of the simulation, and pays
    for one pass in place of three.
    """

    @jax.custom_jvp
    def value(y: Any, args: Any) -> Any:
        return residuals(y, args)

    @value.defjvp
    def both(primals: Any, tangents: Any) -> Any:
        y, args = primals

        def along(direction: Any) -> Any:
            return jax.jvp(lambda y: residuals(y, args), (y,), (direction,))

        found, columns = jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(y)))
        return found, tangents[0] @ columns

    return value


def levenberg_marquardt(
    residuals: Residuals,
    y: Float[np.ndarray, " k"],
    args: Any,
    *,
    max_steps: int,
    tolerance: float,
    progress: Progress = silent,
) -> Search:
    """Minimise the sum of squares of `residuals(y, args)` from `y`.

    Stops when a step changes neither the cost, relative to the first, nor the point by more than `tolerance`, after
    `max_steps`, or when interrupted (Ctrl-C), and returns the best point seen in any case. The Jacobian is forward-mode: it costs about twice a
    simulation with a handful of parameters, and no memory. Raises `DivergenceError` if the start itself has no finite
    cost.
    """
    point = jnp.asarray(y)
    first = float(jnp.linalg.norm(eqx.filter_jit(residuals)(point, args)))
    if not np.isfinite(first):
        raise DivergenceError(
            "the loop diverges where the search starts: start from values with which `simulate` is ok"
        )
    unit, linearised = first / START_NORM, with_jacobian(residuals)

    def fn(y: Any, args: Any) -> tuple[Any, None]:
        return linearised(y, args) / unit, None

    began = time.perf_counter()
    solver = _LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    options: dict[str, Any] = {"jac": "fwd"}
    tags: frozenset[object] = frozenset()
    state = solver.init(fn, point, args, options, *eqx.filter_eval_shape(fn, point, args), tags)
    step = eqx.filter_jit(lambda y, args, state: solver.step(fn, y, args, options, state, tags))
    done = eqx.filter_jit(lambda y, args, state: solver.terminate(fn, y, args, options, state, tags))
    best, cost, history = point, first, [first]
    status, count = f"stopped after {max_steps} steps, still falling", 0
    try:
        for count in range(1, max_steps + 1):
            point, state, _ = step(point, args, state)
            now = unit * float(jnp.sqrt(2.0 * state.f_info.as_min()))
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


def many_starts(
    residuals: Residuals,
    starts: Float[np.ndarray, "s k"],
    args: Any,
    *,
    steps: int,
    progress: Progress = silent,
) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, " s"]]:
    """`steps` steps from each start, all starts as lanes of one program: the best point of each, and its cost.

    The cost is the root of the sum of squares; infinite where a start never had a finite one. Interrupted (Ctrl-C), it
    returns the best so far.
    """
    linearised = with_jacobian(residuals)

    def fn(y: Any, args: Any) -> tuple[Any, None]:
        unit, given = args
        return linearised(y, given) / unit, None

    solver = _LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    options: dict[str, Any] = {"jac": "fwd"}
    tags: frozenset[object] = frozenset()
    lanes = eqx.if_array(0)

    @eqx.filter_jit
    def begin(points: Any, args: Any) -> Any:
        units = jax.vmap(lambda y: jnp.linalg.norm(residuals(y, args)))(points) / START_NORM
        shapes = eqx.filter_eval_shape(fn, points[0], (units[0], args))
        state = eqx.filter_vmap(lambda y, u: solver.init(fn, y, (u, args), options, *shapes, tags), out_axes=lanes)
        return units, state(points, units)

    @eqx.filter_jit
    def step(points: Any, state: Any, units: Any, args: Any) -> Any:
        def one(y: Any, state: Any, unit: Any) -> Any:
            y, state, _ = solver.step(fn, y, (unit, args), options, state, tags)
            return y, state, unit * jnp.sqrt(2.0 * state.f_info.as_min())

        return eqx.filter_vmap(one, in_axes=(0, lanes, 0), out_axes=lanes)(points, state, units)

    points = jnp.asarray(starts)
    units, state = begin(points, args)
    best, costs = np.asarray(points), np.where(np.isfinite(units), START_NORM * np.asarray(units), np.inf)
    with contextlib.suppress(KeyboardInterrupt):
        for count in range(1, steps + 1):
            points, state, cost = step(points, state, units, args)
            now = np.asarray(cost)
            better = np.isfinite(now) & (now < costs)
            best, costs = np.where(better[:, None], points, best), np.where(better, now, costs)
            progress(count, steps, float(costs.min()))
    return best, costs
