"""The loops that are timed: one lane, many lanes, derivatives; each with its compile time, memory and kernels."""

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller, Reference
from diffdrive.loop.costs import running_costs
from diffdrive.loop.rollout import rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.numerics.arrays import Scalar, as_arrays, in_precision_of
from experiments.studies.paper import scenario as paper
from tuning.optimisation.least_squares import LeastSquaresResult, levenberg_marquardt

# eight parameters that a tuner of PD+FC+LE moves
TUNED_PARAMETERS: tuple[Callable[[Any], Scalar], ...] = (
    lambda c: c.tracking.gains.kp,
    lambda c: c.tracking.gains.kd,
    lambda c: c.observer.tuning.position,
    lambda c: c.observer.tuning.velocity,
    lambda c: c.observer.tuning.bristle,
    lambda c: c.observer.tuning.measurement,
    lambda c: c.observer.load_estimator.gain,
    lambda c: c.observer.friction.coulomb_screw.positive,
)

CHECKPOINTS = {1: "reverse", 2: "reverse, every second step kept", 4: "reverse, every fourth step kept"}

MIN_TIME_TRIPS = 50  # a loop of at least so many trips is one over time
START_OFFSET = 0.2  # of a logarithm: from there to the start of a search


class CompiledLoop(NamedTuple):
    """A compiled function with its arguments."""

    run: Callable[[], Any]
    compile_seconds: float
    one_kernel: bool
    memory: int  # bytes, temporary


def one_kernel(text: str) -> bool:
    """Whether a compiled program runs its loops over time as native kernels (CPU).

    Loops of `MIN_TIME_TRIPS` trips or more, or of an unknown number, must lie within a call that is marked as a small
    call; trips of nested loops multiply. Shorter ones, over blocks of lanes or columns of a matrix, need not. A mark
    alone says nothing: the plant's inner loop always has one.
    """
    bodies = dict(re.findall(r"^(?:ENTRY )?%?([\w.\-]+) \([^\n]*\{\n(.*?)^\}", text, re.S | re.M))
    called = {name: re.findall(_CALLS, body) for name, body in bodies.items()}
    marked = [line for line in text.splitlines() if "xla_cpu_small_call" in line]
    native = _reachable(re.findall(r"to_apply=%?([\w.\-]+)", "\n".join(marked)), called)

    @cache
    def trips(name: str) -> int:
        """Of the longest nest of loops in a computation that is not native."""
        if name in native or name not in bodies:
            return 1
        nests = ((_trips(line), re.findall(_CALLS, line)) for line in bodies[name].splitlines())
        return max((count * trips(callee) for count, callees in nests for callee in callees), default=1)

    return bool(native) and max(map(trips, bodies)) < MIN_TIME_TRIPS


_CALLS = r"(?:calls|to_apply|body|condition|true_computation|false_computation)=%?([\w.\-]+)"


def _trips(line: str) -> int:
    if " while(" not in line:
        return 1
    known = re.search(r'"known_trip_count":\{"n":"(\d+)"', line)
    return MIN_TIME_TRIPS if known is None else int(known[1])


def _reachable(names: Iterable[str], called: Mapping[str, Sequence[str]]) -> set[str]:
    """The computations of these names and all that they call."""
    reached: set[str] = set()
    pending = list(names)
    while pending:
        name = pending.pop()
        if name not in reached:
            reached.add(name)
            pending += called.get(name, ())
    return reached


def compile_loop(function: Callable[..., object], *arguments: object) -> CompiledLoop:
    """The function compiled for the arguments."""
    start = time.perf_counter()
    executable = jax.jit(function).lower(*arguments).compile()
    compile_seconds = time.perf_counter() - start
    memory = executable.memory_analysis()
    return CompiledLoop(
        lambda: jax.block_until_ready(executable(*arguments)),  # type: ignore[no-untyped-call]  # jax declares no types of it
        compile_seconds,
        one_kernel(executable.as_text() or ""),
        0 if memory is None else int(memory.temp_size_in_bytes),
    )


def paper_inputs(steps: int, rate: float = 10_000.0) -> Inputs:
    """The paper's motion for `steps` steps, repeated if it is shorter, under a load that grows to 8 kN."""
    motion = paper.canonical().motion
    index = np.arange(steps) % len(motion.time)
    signals = (
        jnp.asarray(np.asarray(signal)[index]) for signal in (motion.position, motion.velocity, motion.acceleration)
    )
    return as_arrays(Inputs(Reference(*signals), jnp.asarray(np.linspace(0.0, 8e3, steps)), jnp.zeros(steps)))


def rms_cost(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling, checkpoint_every: int = 1
) -> Callable[[Drive, Controller, Scalar], Scalar]:
    """RMS error as a function of machine, controller and the factor on the load."""
    counts = jnp.ones_like(inputs.load)

    def cost(drive: Drive, controller: Controller, factor: Scalar) -> Scalar:
        scaled_inputs = inputs._replace(load=factor * inputs.load)
        return running_costs(drive, controller, scaled_inputs, counts, sampling, checkpoint_every=checkpoint_every).rms

    return cost


def single(drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling) -> CompiledLoop:
    """One lane with its costs."""
    models = as_arrays((drive, controller))
    return compile_loop(rms_cost(drive, controller, inputs, sampling), *models, jnp.asarray(1.0))


def lanes(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling, count: int, precision: str = "double"
) -> CompiledLoop:
    """Many machines side by side on one core, each with its own parameters and load."""
    machine, control = as_arrays((drive, controller))
    machines = jax.tree.map(lambda leaf: leaf * jnp.ones(count), machine)
    models = (machines, control, jnp.linspace(0.5, 1.5, count), inputs)
    machines, control, factors, inputs = in_precision_of(jnp.zeros((), precision), models)
    many = jax.vmap(rms_cost(drive, controller, inputs, sampling), in_axes=(0, None, 0))
    return compile_loop(many, machines, control, factors)


class _TunedLoop(NamedTuple):
    """A smooth machine under a controller of eight free parameters, given as logarithms."""

    machine: Drive
    control: Controller
    theta: Float[Array, " k"]

    @classmethod
    def of(cls, drive: Drive, controller: Controller) -> "_TunedLoop":
        machine, control = as_arrays(smooth((drive, controller)))
        return cls(machine, control, jnp.log(jnp.stack([part(control) for part in TUNED_PARAMETERS])))

    def controller_at(self, theta: Float[Array, " k"]) -> Controller:
        values = list(jnp.exp(theta))
        return eqx.tree_at(lambda c: [part(c) for part in TUNED_PARAMETERS], self.control, values)


def reverse(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling, count: int
) -> dict[str, CompiledLoop]:
    """Many lanes forward, and in reverse mode: each with its own load, all under the same eight parameters."""
    tuned, factors = _TunedLoop.of(drive, controller), jnp.linspace(0.5, 1.5, count)

    def lane_costs(theta: Float[Array, " k"], checkpoint_every: int) -> Float[Array, " lanes"] | Scalar:
        cost = rms_cost(tuned.machine, tuned.control, inputs, sampling, checkpoint_every)
        return jax.vmap(lambda factor: cost(tuned.machine, tuned.controller_at(theta), factor))(factors)

    def gradient_loop(checkpoint_every: int) -> CompiledLoop:
        return compile_loop(jax.grad(lambda theta: jnp.mean(lane_costs(theta, checkpoint_every))), tuned.theta)

    return {"forward": compile_loop(lambda theta: lane_costs(theta, 1), tuned.theta)} | {
        name: gradient_loop(checkpoint_every) for checkpoint_every, name in CHECKPOINTS.items()
    }


def tuner(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling, steps: int
) -> tuple[CompiledLoop, Callable[[], LeastSquaresResult], int]:
    """One pass for residuals and Jacobian; a Levenberg-Marquardt search of at most `steps` steps; how many it takes."""
    tuned = _TunedLoop.of(drive, controller)

    def residuals(theta: Float[Array, " k"], args: tuple[Drive, Array]) -> Float[Array, " n"]:
        machine, reference = args
        return reference - rollout_loop(machine, tuned.controller_at(theta), inputs, sampling).table_position

    def value_and_jacobian(theta: Float[Array, " k"], args: tuple[Drive, Array]) -> tuple[Array, Array]:
        return jax.vmap(
            lambda direction: jax.jvp(lambda theta: residuals(theta, args), (theta,), (direction,)), out_axes=(None, 0)
        )(jnp.eye(len(theta)))

    args = (tuned.machine, inputs.reference.position)
    start = np.asarray(tuned.theta) + START_OFFSET * (-1.0) ** np.arange(len(TUNED_PARAMETERS))

    def search() -> LeastSquaresResult:
        return levenberg_marquardt(residuals, start, args, max_steps=steps, tolerance=1e-15, min_gain=0.0)

    return compile_loop(value_and_jacobian, jnp.asarray(start), args), search, search().steps


def by_parameters(
    drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling, counts: Sequence[int]
) -> dict[int, CompiledLoop]:
    """One lane forward (0), and its derivative in forward mode by each number of the eight parameters."""
    tuned = _TunedLoop.of(drive, controller)

    def rms(free: Float[Array, " free"]) -> Scalar:
        theta = jnp.concatenate([free, tuned.theta[len(free) :]])
        return rms_cost(tuned.machine, tuned.control, inputs, sampling)(
            tuned.machine, tuned.controller_at(theta), jnp.asarray(1.0)
        )

    return {0: compile_loop(rms, tuned.theta)} | {
        count: compile_loop(jax.jacfwd(rms), tuned.theta[:count]) for count in counts
    }


def derivatives(drive: Drive, controller: Controller, inputs: Inputs, sampling: Sampling) -> dict[str, CompiledLoop]:
    """One lane forward, and its derivatives by eight parameters in several ways."""
    tuned = _TunedLoop.of(drive, controller)
    machine, control, theta_0, controller_at = tuned.machine, tuned.control, tuned.theta, tuned.controller_at

    def residuals(theta: Float[Array, " k"]) -> Float[Array, " n"] | Scalar:
        return inputs.reference.position - rollout_loop(machine, controller_at(theta), inputs, sampling).table_position

    def rms(theta: Float[Array, " k"], checkpoint_every: int = 1) -> Scalar:
        return rms_cost(machine, control, inputs, sampling, checkpoint_every)(
            machine, controller_at(theta), jnp.asarray(1.0)
        )

    def normal_equations(theta: Float[Array, " k"]) -> tuple[Array, Array]:
        residual, jacobian = residuals(theta), jax.jacfwd(residuals)(theta)
        return jacobian.T @ jacobian, jacobian.T @ residual

    return {
        "forward": compile_loop(rms, theta_0),
        "forward, residuals": compile_loop(residuals, theta_0),
        "jacfwd, 8 parameters": compile_loop(jax.jacfwd(rms), theta_0),
        "Jacobian of residuals": compile_loop(jax.jacfwd(residuals), theta_0),
        "Gauss-Newton": compile_loop(normal_equations, theta_0),
    } | {
        name: compile_loop(jax.grad(partial(rms, checkpoint_every=checkpoint_every)), theta_0)
        for checkpoint_every, name in CHECKPOINTS.items()
    }
