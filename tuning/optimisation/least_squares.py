"""Levenberg-Marquardt, one step at a time, so that it can show its progress and always returns the best it has seen.

From one start, or from many in one vmapped program.
"""

import enum
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx  # type: ignore[import-untyped]
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float, PyTree

from diffdrive.errors import DivergenceError, ParameterError
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
# A step counts that gains a hundredth of what was foreseen; after one that gains half of it the damping falls. (Usual
# are 0.25 and 0.75, Nocedal and Wright, Numerical Optimization, ch. 4; friction hardly ever grants as much.)
ACCEPTED, GOOD = 0.01, 0.5
FASTER = 10.0  # by which the damping falls, and rises
BLOCK = 512  # rows that are decomposed at once: with 16 columns 64 KB, a cache of the second level at most


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

        def along(direction: Theta) -> tuple[Array, Array]:
            return jax.jvp(lambda theta: residuals(theta, args), (theta,), (direction,))

        found, columns = jax.vmap(along, out_axes=(None, 0))(jnp.eye(len(theta)))
        return found, tangents[0] @ columns

    return value


# Compiled once for each `residuals`: where that is hashed by value, a second search costs no compilation. The algebra
# of a step is NumPy's: beside a simulation of all samples it costs nothing, and a program that has it too takes longer
# to compile.


def _linearise(residuals: Residuals, theta: Theta, args: PyTree) -> tuple[Float[Array, " m"], Float[Array, "m k"]]:
    """The residuals at theta, and their derivative by it, in one forward pass for all parameters."""

    def along(direction: Theta) -> tuple[Array, Array]:
        return jax.jvp(lambda theta: residuals(theta, args), (theta,), (direction,))

    return jax.vmap(along, out_axes=(None, 1))(jnp.eye(len(theta)))


linearised = eqx.filter_jit(_linearise)


@eqx.filter_jit
def _linearised_lanes(
    residuals: Residuals, points: Float[Array, "s k"], args: PyTree
) -> tuple[Float[Array, "s m"], Float[Array, "s m k"]]:
    return jax.vmap(lambda theta: _linearise(residuals, theta, args))(points)


class _SearchState(NamedTuple):
    """A search between two evaluations; residuals are in units in which they began with the norm `START_NORM`."""

    theta: Float[np.ndarray, " k"]  # the best so far
    residual: Float[np.ndarray, " m"]
    triangle: Float[np.ndarray, "r k1"]  # `_triangle` of both there
    damping: float
    unit: float
    trial: Float[np.ndarray, " k"]  # to be evaluated next

    @property
    def cost(self) -> float:
        """The root of the sum of squares, in the residuals' own units."""
        return self.unit * float(np.sqrt(_square(self.residual)))


def _square(residual: Float[np.ndarray, " m"]) -> float:
    """The sum of squares; infinite where it is beyond all numbers."""
    with np.errstate(over="ignore"):
        return float(np.sum(residual**2))


def _triangle(residual: Float[np.ndarray, " m"], slope: Float[np.ndarray, "m k"]) -> Float[np.ndarray, "r k1"]:
    """R of a QR decomposition of derivative and residual: k + 1 rows that say of any step what all m do.

    Block by block, and of the blocks' rows again (Demmel et al., Communication-optimal parallel and sequential QR and
    LU factorizations, SIAM J. Sci. Comput. 34, 2012): what fits into a cache takes half the time, and no threads.
    """
    rows = np.column_stack([slope, residual])
    count = rows.shape[1]
    block = max(BLOCK, 4 * count)
    while len(rows) > block:
        whole = len(rows) // block * block
        reduced = np.linalg.qr(rows[:whole].reshape(-1, block, count), mode="r")
        rows = np.vstack([reduced.reshape(-1, count), rows[whole:]])
    return np.linalg.qr(rows, mode="r")


def _damped_step(triangle: Float[np.ndarray, "r k1"], damping: float) -> Float[np.ndarray, " k"]:
    """The step to the minimum of the linearised residuals, and of `damping` times its own square."""
    count = triangle.shape[1] - 1
    rows = np.vstack([triangle, np.sqrt(damping) * np.eye(count, count + 1)])
    orthogonal, upper = np.linalg.qr(rows[:, :-1])
    return -np.linalg.solve(upper, orthogonal.T @ rows[:, -1])


def _begun(theta: Float[np.ndarray, " k"], residual: Float[np.ndarray, " m"], slope: np.ndarray) -> _SearchState:
    unit = float(np.sqrt(_square(residual))) / START_NORM or 1.0  # a start without any error is the end
    triangle = _triangle(residual / unit, slope / unit)
    return _SearchState(theta, residual / unit, triangle, 1.0, unit, theta + _damped_step(triangle, 1.0))


def _after(state: _SearchState, residual: Float[np.ndarray, " m"], slope: np.ndarray) -> tuple[_SearchState, bool]:
    """The search once its trial was evaluated, and whether the step was taken."""
    with np.errstate(over="ignore"):
        residual = residual / state.unit
    is_finite = np.isfinite(residual).all() and np.isfinite(slope).all()
    found = 0.5 * (_square(residual) - _square(state.residual)) if is_finite else np.inf
    before = state.triangle[:, -1]
    ahead = state.triangle[:, :-1] @ (state.trial - state.theta) + before
    foreseen = 0.5 * float(ahead @ ahead - before @ before)
    if not found <= ACCEPTED * foreseen:
        damping = state.damping * FASTER
        return state._replace(damping=damping, trial=state.theta + _damped_step(state.triangle, damping)), False
    damping = state.damping / FASTER if foreseen < 0 and found < GOOD * foreseen else state.damping
    triangle = _triangle(residual, slope / state.unit)
    trial = state.trial + _damped_step(triangle, damping)
    return _SearchState(state.trial, residual, triangle, damping, state.unit, trial), True


def _has_settled(before: _SearchState, state: _SearchState, tolerance: float) -> bool:
    """Whether the last step changed neither the point nor any residual, beside themselves and one (Cauchy's test)."""
    pairs = ((before.theta, state.theta), (before.residual, state.residual))
    return all(np.all(np.abs(now - was) < tolerance * (1.0 + np.abs(now))) for was, now in pairs)


def relative_offset(triangle: Float[np.ndarray, "r k1"], count: int) -> float:
    """How far from the minimum a point with `count` residuals is, beside how well these say where that is.

    Of the residual the part that the derivative's columns span over the rest, each as a root mean square. Times the
    root of k it bounds how many standard errors any parameter, or combination of some, is from its estimate (Bates and
    Watts, A relative offset orthogonality convergence criterion for nonlinear least squares, Technometrics 23, 1981).
    Infinite where there are no more residuals than parameters, or the rest is nothing.
    """
    parameters = triangle.shape[1] - 1
    if count <= parameters or triangle[-1, -1] == 0.0:
        return np.inf
    spanned, rest = float(np.linalg.norm(triangle[:-1, -1])), abs(float(triangle[-1, -1]))
    return spanned / rest * float(np.sqrt((count - parameters) / parameters))


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
    """Minimise the sum of squares of `residuals(theta, args)` from `theta` (Marquardt 1963).

    Stops when a step changes neither any residual, relative to the first cost, nor the point by more than `tolerance`,
    where the `relative_offset` of a point is below `min_offset`, when three steps gained less than `min_gain` of the
    cost, after `max_steps` evaluations, or when interrupted (Ctrl-C), and returns the best point seen in any case. The
    Jacobian is forward-mode: it costs about twice a simulation with a handful of parameters. Raises `DivergenceError`
    if the start itself has no finite cost.
    """
    started = time.perf_counter()

    def evaluate(point: Float[np.ndarray, " k"]) -> tuple[np.ndarray, np.ndarray]:
        value, slope = linearised(residuals, jnp.asarray(point), args)
        return np.asarray(value), np.asarray(slope)

    value, slope = evaluate(np.asarray(theta, float))
    initial_cost = float(np.sqrt(_square(value)))
    if not np.isfinite(initial_cost):
        raise DivergenceError(
            "the loop diverges where the search starts: start from values with which `simulate` is ok"
        )
    state = _begun(np.asarray(theta, float), value, slope)
    history, accepted_costs = [initial_cost, initial_cost], [initial_cost]
    outcome, status, count = Outcome.STOPPED, f"stopped after {max_steps} steps, still falling", 1
    try:
        progress(count, max_steps, initial_cost)
        is_settled = False
        while not is_settled and not relative_offset(state.triangle, len(value)) < min_offset:
            if count == max_steps:
                break
            count += 1
            before = state
            state, accepted = _after(state, *evaluate(state.trial))
            history.append(state.cost)
            progress(count, max_steps, state.cost)
            if accepted:
                accepted_costs.append(state.cost)
                is_settled = _has_settled(before, state, tolerance)
            if len(accepted_costs) > STALLED_STEPS:
                is_settled |= accepted_costs[-1 - STALLED_STEPS] - state.cost < min_gain * state.cost
        else:
            outcome, status = Outcome.CONVERGED, "converged"
    except KeyboardInterrupt:
        outcome, status = Outcome.INTERRUPTED, f"interrupted after {count - 1} steps"
    seconds = time.perf_counter() - started
    return LeastSquaresResult(state.theta, outcome, status, initial_cost, state.cost, count, seconds, history)


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
    trials, costs = np.array(starts, float), np.full(len(starts), np.inf)
    lanes: list[_SearchState | None] = [None] * len(starts)
    interrupted = False
    try:
        for count in range(1, steps + 1):
            values, slopes = (np.asarray(array) for array in _linearised_lanes(residuals, jnp.asarray(trials), args))
            for k, (lane, value, slope) in enumerate(zip(lanes, values, slopes, strict=True)):
                if lane is not None:
                    lane, _ = _after(lane, value, slope)
                elif count == 1 and np.isfinite(_square(value)) and np.isfinite(slope).all():
                    lane = _begun(trials[k].copy(), value, slope)
                if lane is not None:
                    lanes[k], trials[k], costs[k] = lane, lane.trial, lane.cost
            progress(count, steps, float(costs.min()))
    except KeyboardInterrupt:
        interrupted = True
    best = [start if lane is None else lane.theta for start, lane in zip(np.asarray(starts), lanes, strict=True)]
    return np.array(best), costs, interrupted
