"""Levenberg-Marquardt, one step at a time, so that it can show its progress and always returns the best it has seen.

From one start, or from many in one vmapped program.
"""

import enum
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx  # type: ignore[import-untyped]
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from diffdrive.errors import DivergenceError, ParameterError
from diffdrive.numerics.directions import along_each
from diffdrive.support.resources import require_memory

StepProgress = Callable[[int, int, float], None]
Theta = Float[Array, " k"]
Residuals = Callable[[Theta, PyTree], Float[Array, " m"]]


def no_progress(step: int, most: int, cost: float) -> None:
    """Show nothing."""


class Outcome(enum.StrEnum):
    """Why a search ended; programs go by it, its status says it in words."""

    CONVERGED = "converged"
    STOPPED = "stopped"  # after its last step, or by the solver
    INTERRUPTED = "interrupted"  # by Ctrl-C


@dataclass(frozen=True)
class LeastSquaresResult:
    """Where a search ended: the best point, why it stopped, and the root of the sum of squares along the way."""

    theta: np.ndarray
    outcome: Outcome
    status: str  # the outcome in words
    initial_cost: float
    cost: float
    steps: int
    seconds: float
    history: list[float]

    def interrupted(self) -> "LeastSquaresResult":
        """The same point, as far as a search came that somebody stopped."""
        status = f"interrupted after {self.steps} steps"
        return replace(self, outcome=Outcome.INTERRUPTED, status=status)


class LevenbergMarquardt(optx.AbstractGaussNewton[Array, Array, None]):
    """optimistix's, but its damping falls tenfold after each step that goes at least half as well as foreseen.

    The stock one waits for steps that go 99 % as well, which a simulation of friction hardly ever grants.
    """

    rtol: float
    atol: float
    norm: Callable[[PyTree], Array] = optx.max_norm
    descent: optx.DampedNewtonDescent[Array] = optx.DampedNewtonDescent(linear_solver=lx.QR())
    search: optx.ClassicalTrustRegion[Array] = optx.ClassicalTrustRegion(
        high_cutoff=0.5, low_cutoff=0.01, high_constant=10.0, low_constant=0.1
    )
    verbose: Callable[..., None] = eqx.field(static=True, default=lambda **_: None)


STALLED_STEPS = 3  # a search that gains next to nothing in so many steps has arrived
START_NORM = 10.0  # the residuals are scaled to it at the start, so that the first damping of 1 is a light one


def with_jacobian(residuals: Residuals) -> Residuals:
    """The same residuals, whose derivative is one forward pass for all parameters at once, alongside the value.

    A solver that linearises them keeps the Jacobian, [m, k], in place of every intermediate of the simulation, and pays
    for one pass in place of three.
    """

    @jax.custom_jvp
    def value(theta: Theta, args: PyTree) -> Float[Array, " m"]:
        return residuals(theta, args)

    @value.defjvp
    def both(primals: tuple[Theta, PyTree], tangents: tuple[Theta, PyTree]) -> tuple[Array, Array]:
        theta, args = primals
        found, columns = along_each(lambda theta: residuals(theta, args), theta, axis=0)
        return found, tangents[0] @ columns

    return value


OPTIONS: dict[str, object] = {"jac": "fwd"}
NO_TAGS: frozenset[object] = frozenset()


def _scaled(residuals: Residuals) -> Callable[[Theta, PyTree], tuple[Float[Array, " m"], None]]:
    linearised = with_jacobian(residuals)

    def fn(theta: Theta, args: PyTree) -> tuple[Float[Array, " m"], None]:
        unit, scaled_args = args
        return linearised(theta, scaled_args) / unit, None

    return fn


# These are compiled once for each `residuals`: where that is hashed by value, a second search costs no compilation.


@eqx.filter_jit
def _value(residuals: Residuals, theta: Theta, args: PyTree) -> Float[Array, " m"]:
    return residuals(theta, args)


def _blank(theta: Theta, args: PyTree) -> Float[Array, " m"]:
    return args + 0.0 * jnp.sum(theta)


@eqx.filter_jit
def _begin(solver: LevenbergMarquardt, theta: Theta, unit: Float[Array, ""], blank: Float[Array, " m"]) -> PyTree:
    """The state before the first step. It has the shapes of a point's value and derivative, and none of their numbers,
    so that nothing is simulated for it: `blank` stands for the residuals.
    """
    fn, args = _scaled(_blank), (unit, blank)
    f_struct, aux_struct = eqx.filter_eval_shape(fn, theta, args)
    return solver.init(fn, theta, args, OPTIONS, f_struct, aux_struct, NO_TAGS)


def relative_offset(residual: Float[Array, " m"], jacobian: Float[Array, "m k"]) -> Float[Array, ""]:
    """How far from the minimum a point is, beside how well its residuals say where that is.

    The part of the residual that the columns of the Jacobian span, over the rest, each as a root mean square. Times the
    root of k it bounds how many standard errors any parameter, or combination of some, is from its estimate (Bates and
    Watts, A relative offset orthogonality convergence criterion for nonlinear least squares, Technometrics 23, 1981).
    Infinite where there are no more residuals than parameters, and NaN where one of these has no effect.
    """
    count, parameters = jacobian.shape
    if count <= parameters:
        return jnp.asarray(jnp.inf)
    columns = jacobian / jnp.linalg.norm(jacobian, axis=0)  # parameters differ by many orders in what they do
    along = residual @ columns
    spanned = along @ jnp.linalg.solve(columns.T @ columns, along)
    return jnp.sqrt(spanned / parameters / ((residual @ residual - spanned) / (count - parameters)))


@eqx.filter_jit
def _step(
    residuals: Residuals, solver: LevenbergMarquardt, theta: Theta, args: PyTree, state: PyTree
) -> tuple[Theta, PyTree, Array, Array, Array, optx.RESULTS]:
    fn = _scaled(residuals)
    theta, state, _ = solver.step(fn, theta, args, OPTIONS, state, NO_TAGS)
    finished, result = solver.terminate(fn, theta, args, OPTIONS, state, NO_TAGS)
    offset = relative_offset(state.f_info.residual, state.f_info.jac.as_matrix())
    return theta, state, args[0] * jnp.sqrt(2.0 * state.f_info.as_min()), offset, finished, result


def levenberg_marquardt(
    residuals: Residuals,
    theta: Float[np.ndarray, " k"],
    args: PyTree,
    *,
    max_steps: int,
    tolerance: float,
    min_gain: float = 1e-7,
    min_offset: float = 0.0,
    progress: StepProgress = no_progress,
) -> LeastSquaresResult:
    """Minimise the sum of squares of `residuals(theta, args)` from `theta`.

    Stops when a step changes neither the cost, relative to the first, nor the point by more than `tolerance`, after
    `max_steps`, or when interrupted (Ctrl-C), and returns the best point seen in any case. The Jacobian is
    forward-mode: it costs about twice a simulation with a handful of parameters. Raises `DivergenceError` if the start
    itself has no finite cost. `min_gain` is the share of the cost that three steps must gain to be worth going on,
    `min_offset` the `relative_offset` below which a point is the minimum.
    """
    started = time.perf_counter()
    point = jnp.asarray(theta)
    value_at_start = _value(residuals, point, args)
    initial_cost = float(jnp.linalg.norm(value_at_start))
    if not np.isfinite(initial_cost):
        raise DivergenceError(
            "the loop diverges where the search starts: start from values with which `simulate` is ok"
        )
    solver = LevenbergMarquardt(rtol=tolerance, atol=tolerance)
    scaled_args = (jnp.asarray(initial_cost / START_NORM), args)
    best, cost, history, accepted_costs = point, initial_cost, [initial_cost], [initial_cost]
    outcome, status, count = Outcome.STOPPED, f"stopped after {max_steps} steps, still falling", 0
    try:
        state = _begin(solver, point, scaled_args[0], jnp.zeros_like(value_at_start))
        for count in range(1, max_steps + 1):
            point, state, value, offset, finished, result = _step(residuals, solver, point, scaled_args, state)
            new_cost = float(value)
            history.append(new_cost)
            if np.isfinite(new_cost) and new_cost < cost:
                best, cost = point, new_cost
            progress(count, max_steps, cost)
            if accepted_costs[-1] != float(new_cost):
                accepted_costs.append(float(new_cost))  # a step that was taken, not one that only raised the damping
            has_stalled = (
                len(accepted_costs) > STALLED_STEPS and accepted_costs[-1 - STALLED_STEPS] - cost < min_gain * cost
            )
            if has_stalled or float(offset) < min_offset:
                outcome, status = Outcome.CONVERGED, "converged"
                break
            if bool(finished):
                outcome, status = Outcome.STOPPED, f"stopped: {result}"
                if bool(result == optx.RESULTS.successful):
                    outcome, status = Outcome.CONVERGED, "converged"
                break
    except KeyboardInterrupt:
        outcome, status = Outcome.INTERRUPTED, f"interrupted after {count - 1} steps"
    return LeastSquaresResult(
        np.asarray(best), outcome, status, initial_cost, cost, count, time.perf_counter() - started, history
    )


_LANES = eqx.if_array(0)


@eqx.filter_jit
def _begin_lanes(
    residuals: Residuals, solver: LevenbergMarquardt, points: Float[Array, "s k"], args: PyTree
) -> tuple[Float[Array, " s"], PyTree]:
    values = jax.vmap(lambda theta: residuals(theta, args))(points)
    units, blank = jnp.linalg.norm(values, axis=1) / START_NORM, jnp.zeros_like(values[0])

    def init_lane(theta: Theta, unit: Float[Array, ""]) -> PyTree:
        return _begin(solver, theta, unit, blank)

    return units, eqx.filter_vmap(init_lane, out_axes=_LANES)(points, units)


@eqx.filter_jit
def _step_lanes(
    residuals: Residuals,
    solver: LevenbergMarquardt,
    points: Float[Array, "s k"],
    units: Float[Array, " s"],
    args: PyTree,
    state: PyTree,
) -> tuple[Float[Array, "s k"], PyTree, Float[Array, " s"]]:
    fn = _scaled(residuals)

    def step_lane(theta: Theta, unit: Float[Array, ""], state: PyTree) -> tuple[Theta, PyTree, Array]:
        theta, state, _ = solver.step(fn, theta, (unit, args), OPTIONS, state, NO_TAGS)
        return theta, state, unit * jnp.sqrt(2.0 * state.f_info.as_min())

    return eqx.filter_vmap(step_lane, in_axes=(0, 0, _LANES), out_axes=_LANES)(points, units, state)


def require_search_memory(residuals: Residuals, starts: Float[np.ndarray, "s k"], args: PyTree) -> None:
    """Raise `ParameterError` where searches from all these starts at once do not fit into memory.

    Each holds its residuals and their derivative by every parameter.
    """
    count = sum(leaf.size for leaf in jax.tree.leaves(jax.eval_shape(residuals, jnp.zeros(starts.shape[1]), args)))
    needed = 8.0 * len(starts) * count * (starts.shape[1] + 2)
    request = f"a search from {len(starts)} starts side by side, each with {count} residuals,"
    require_memory(ParameterError, request, needed, "give fewer starts")


def multistart(
    residuals: Residuals,
    starts: Float[np.ndarray, "s k"],
    args: PyTree,
    *,
    steps: int,
    progress: StepProgress = no_progress,
) -> tuple[Float[np.ndarray, "s k"], Float[np.ndarray, " s"], bool]:
    """`steps` steps from each start, all starts as lanes of one program: the best point of each, and its cost.

    The cost is the root of the sum of squares; infinite where a start never had a finite one. Interrupted (Ctrl-C), it
    returns the best so far and says so, with True at the end.
    """
    require_search_memory(residuals, starts, args)
    solver = LevenbergMarquardt(rtol=0.0, atol=0.0)
    points = jnp.asarray(starts)
    units, state = _begin_lanes(residuals, solver, points, args)
    best, costs = np.asarray(points), START_NORM * np.nan_to_num(np.asarray(units), nan=np.inf)
    interrupted = False
    try:
        for count in range(1, steps + 1):
            points, state, cost = _step_lanes(residuals, solver, points, units, args, state)
            now = np.asarray(cost)
            better = np.isfinite(now) & (now < costs)
            best, costs = np.where(better[:, None], points, best), np.where(better, now, costs)
            progress(count, steps, float(costs.min()))
    except KeyboardInterrupt:
        interrupted = True
    return best, costs, interrupted
