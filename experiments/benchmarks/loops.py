"""The loops that are timed: one lane, many lanes, derivatives; each with what the compiler made of it."""

import re
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import cache, partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffdrive.controllers import Controller, Reference
from diffdrive.loop.simulate import Inputs, rollout, running_costs
from diffdrive.loop.smooth import smooth
from diffdrive.model.parameters import Drive, Sampling, as_arrays, in_precision_of
from experiments.studies.paper import scenario as paper
from tuning.optimisation.least_squares import levenberg_marquardt

# eight parameters that a tuner of PD+FC+LE moves
EIGHT = (
    lambda c: c.tracking.gains.kp,
    lambda c: c.tracking.gains.kd,
    lambda c: c.observer.tuning.position,
    lambda c: c.observer.tuning.velocity,
    lambda c: c.observer.tuning.bristle,
    lambda c: c.observer.tuning.measurement,
    lambda c: c.observer.load_estimator.gain,
    lambda c: c.observer.friction.coulomb_screw.positive,
)

KEPT = {1: "reverse", 2: "reverse, every second step kept", 4: "reverse, every fourth step kept"}

MANY = 50  # trips, from which a loop is one over time
AWAY = 0.2  # of a logarithm, how far from there a search begins


class Loop(NamedTuple):
    """A compiled function with its arguments."""

    run: Callable[[], Any]
    compile_seconds: float
    one_kernel: bool
    memory: int  # bytes, temporary


def one_kernel(text: str) -> bool:
    """Whether a compiled program runs its loops over time as native kernels (CPU).

    Loops of `MANY` trips or more, or of a number that is not known, must lie within a call that is marked so; loops
    within loops count together. Shorter ones, over blocks of lanes or the columns of a matrix, may be where they are.
    That there is a mark says nothing by itself: the plant's inner loop always carries it.
    """
    bodies = dict(re.findall(r"^(?:ENTRY )?%?([\w.\-]+) \([^\n]*\{\n(.*?)^\}", text, re.S | re.M))
    called = {name: re.findall(_CALLS, body) for name, body in bodies.items()}
    marked = [line for line in text.splitlines() if "xla_cpu_small_call" in line]
    native = _reached(re.findall(r"to_apply=%?([\w.\-]+)", "\n".join(marked)), called)

    @cache
    def trips(name: str) -> int:
        """Of the longest nest of loops there that is not native."""
        if name in native or name not in bodies:
            return 1
        nests = ((_trips(line), re.findall(_CALLS, line)) for line in bodies[name].splitlines())
        return max((count * trips(one) for count, every in nests for one in every), default=1)

    return bool(native) and max(map(trips, bodies)) < MANY


_CALLS = r"(?:calls|to_apply|body|condition|true_computation|false_computation)=%?([\w.\-]+)"


def _trips(line: str) -> int:
    if " while(" not in line:
        return 1
    known = re.search(r'"known_trip_count":\{"n":"(\d+)"', line)
    return MANY if known is None else int(known[1])


def _reached(names: Iterable[str], called: Mapping[str, Sequence[str]]) -> set[str]:
    """The computations of these names and all that they call."""
    found: set[str] = set()
    left = list(names)
    while left:
        one = left.pop()
        if one not in found:
            found.add(one)
            left += called.get(one, ())
    return found


def loop(function: Any, *arguments: Any) -> Loop:
    """The function compiled for the arguments."""
    began = time.perf_counter()
    built = jax.jit(function).lower(*arguments).compile()
    took = time.perf_counter() - began
    memory = built.memory_analysis()
    return Loop(
        lambda: jax.block_until_ready(built(*arguments)),
        took,
        one_kernel(built.as_text()),
        0 if memory is None else int(memory.temp_size_in_bytes),
    )


def inputs(steps: int, rate: float = 10_000.0) -> Inputs:
    """The paper's motion for so many steps, again and again if it is shorter, under a load that grows to 8 kN."""
    there = paper.canonical().motion
    again = np.arange(steps) % len(there.time)
    signals = (np.asarray(one)[again] for one in (there.position, there.velocity, there.acceleration))
    return as_arrays(Inputs(Reference(*signals), np.linspace(0.0, 8e3, steps), np.zeros(steps)))


def costs(drive: Drive, controller: Controller, given: Inputs, sampling: Sampling, kept: int = 1) -> Any:
    """RMS error as a function of machine, controller and the factor on the load."""
    counts = jnp.ones_like(given.load)

    def of(drive: Drive, controller: Controller, factor: Any) -> Any:
        now = given._replace(load=factor * given.load)
        return running_costs(drive, controller, now, counts, sampling, checkpoint_every=kept).rms

    return of


def single(drive: Drive, controller: Controller, given: Inputs, sampling: Sampling) -> Loop:
    """One lane with its costs."""
    models = as_arrays((drive, controller))
    return loop(costs(drive, controller, given, sampling), *models, jnp.asarray(1.0))


def lanes(
    drive: Drive, controller: Controller, given: Inputs, sampling: Sampling, count: int, precision: str = "double"
) -> Loop:
    """Many machines side by side on one core, each with parameters and a load of its own."""
    machine, control = as_arrays((drive, controller))
    machines = jax.tree.map(lambda leaf: leaf * jnp.ones(count), machine)
    models = (machines, control, jnp.linspace(0.5, 1.5, count), given)
    machines, control, factors, given = in_precision_of(jnp.zeros((), precision), models)
    many = jax.vmap(costs(drive, controller, given, sampling), in_axes=(0, None, 0))
    return loop(many, machines, control, factors)


class _Eight(NamedTuple):
    """A smooth machine under a controller of eight free parameters, given as logarithms."""

    machine: Drive
    control: Controller
    at: Any

    @classmethod
    def of(cls, drive: Drive, controller: Controller) -> "_Eight":
        machine, control = as_arrays(smooth((drive, controller)))
        return cls(machine, control, jnp.log(jnp.stack([part(control) for part in EIGHT])))

    def placed(self, y: Any) -> Controller:
        parts: Sequence[Any] = list(jnp.exp(y))
        return eqx.tree_at(lambda c: [part(c) for part in EIGHT], self.control, parts)


def reverse(drive: Drive, controller: Controller, given: Inputs, sampling: Sampling, count: int) -> dict[str, Loop]:
    """Many lanes forward, and in reverse mode: each with a load of its own, all under the same eight parameters."""
    eight, factors = _Eight.of(drive, controller), jnp.linspace(0.5, 1.5, count)

    def each(y: Any, kept: int) -> Any:
        of = costs(eight.machine, eight.control, given, sampling, kept)
        return jax.vmap(lambda factor: of(eight.machine, eight.placed(y), factor))(factors)

    def backwards(kept: int) -> Loop:
        return loop(jax.grad(lambda y: jnp.mean(each(y, kept))), eight.at)

    return {"forward": loop(lambda y: each(y, 1), eight.at)} | {name: backwards(kept) for kept, name in KEPT.items()}


def tuner(
    drive: Drive, controller: Controller, given: Inputs, sampling: Sampling, steps: int
) -> tuple[Loop, Callable[[], Any], int]:
    """One pass that gives residuals and Jacobian; and a Levenberg-Marquardt search of so many steps, with how many it
    takes.
    """
    eight = _Eight.of(drive, controller)

    def residuals(y: Any, args: Any) -> Any:
        machine, reference = args
        return reference - rollout(machine, eight.placed(y), given, sampling).position

    def along(y: Any, args: Any) -> Any:
        return jax.vmap(lambda way: jax.jvp(lambda y: residuals(y, args), (y,), (way,)), out_axes=(None, 0))(
            jnp.eye(len(y))
        )

    args = (eight.machine, given.reference.position)
    start = np.asarray(eight.at) + AWAY * (-1.0) ** np.arange(len(EIGHT))

    def search() -> Any:
        return levenberg_marquardt(residuals, start, args, max_steps=steps, tolerance=1e-15, enough=0.0)

    return loop(along, jnp.asarray(start), args), search, search().steps


def by_parameters(
    drive: Drive, controller: Controller, given: Inputs, sampling: Sampling, counts: Sequence[int]
) -> dict[int, Loop]:
    """One lane forward, as none, and its derivative in forward mode by so many of the eight parameters."""
    eight = _Eight.of(drive, controller)

    def rms(some: Any) -> Any:
        y = jnp.concatenate([some, eight.at[len(some) :]])
        return costs(eight.machine, eight.control, given, sampling)(eight.machine, eight.placed(y), jnp.asarray(1.0))

    return {0: loop(rms, eight.at)} | {count: loop(jax.jacfwd(rms), eight.at[:count]) for count in counts}


def derivatives(drive: Drive, controller: Controller, given: Inputs, sampling: Sampling) -> dict[str, Loop]:
    """One lane forward, and its derivatives by eight parameters in several ways."""
    eight = _Eight.of(drive, controller)
    machine, control, at, placed = eight.machine, eight.control, eight.at, eight.placed

    def residuals(y: Any) -> Any:
        return given.reference.position - rollout(machine, placed(y), given, sampling).position

    def rms(y: Any, kept: int = 1) -> Any:
        return costs(machine, control, given, sampling, kept)(machine, placed(y), jnp.asarray(1.0))

    def normal(y: Any) -> Any:
        residual, slope = residuals(y), jax.jacfwd(residuals)(y)
        return slope.T @ slope, slope.T @ residual

    return {
        "forward": loop(rms, at),
        "forward, residuals": loop(residuals, at),
        "jacfwd, 8 parameters": loop(jax.jacfwd(rms), at),
        "Jacobian of residuals": loop(jax.jacfwd(residuals), at),
        "Gauss-Newton": loop(normal, at),
    } | {name: loop(jax.grad(partial(rms, kept=kept)), at) for kept, name in KEPT.items()}
