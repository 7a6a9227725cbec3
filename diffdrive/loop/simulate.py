"""The closed loop, one control step at a time, and its roll-out over a motion.

    scale -> controller (with its observer) -> command -> actuator -> force -> plant -> ...

A step begins where a controller's interrupt routine begins, with the measurement; the estimate used at k rests on
the measurement at k and on the force applied up to k, so there is no algebraic loop.
"""

import operator
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple, SupportsIndex, TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float, PyTree

from diffdrive.controllers import Controller, Reference
from diffdrive.effects import feasibility, stages
from diffdrive.effects.base import Effect, Push
from diffdrive.errors import MotionError, ParameterError
from diffdrive.loop.convergence import convergence_warnings
from diffdrive.loop.metrics import safe_sqrt
from diffdrive.loop.run import Run, with_status
from diffdrive.model import actuator, plant, sensor
from diffdrive.model.friction import friction_force, lugre_coefficients
from diffdrive.model.parameters import Drive, Sampling, check_drive
from diffdrive.model.quantity import check
from diffdrive.motion.load import Ramp, require_resolved_friction, validated_load
from diffdrive.motion.motion import Limits, Motion, require_within
from diffdrive.numerics.arrays import Scalar, as_arrays, in_precision_of, require_double_precision
from diffdrive.numerics.once import once
from diffdrive.numerics.pipeline import require_shorter
from diffdrive.observers.friction_observer import ObserverEstimate
from diffdrive.support.messages import short_repr
from diffdrive.support.rates import is_same_rate
from diffdrive.support.resources import require_memory

INPUT_ARRAYS, OUTPUT_ARRAYS, DOUBLE_BYTES = (
    8,
    14,
    8,
)  # arrays over the samples of a run, those over the kept ones, and bytes of a number


class Inputs(NamedTuple):
    """The inputs of the loop, [n] over time or scalars at one step."""

    reference: Reference
    load: Float[Array, " n"] | Scalar  # N on the guides
    disturbance: Float[Array, " n"] | Scalar  # N on the table beside the actuator's: process force, test pulses


class Frame(NamedTuple):
    """The recorded signals of one control step: those at sample k, and the command issued at k."""

    position: Scalar  # m, of the table
    velocity: Scalar  # m/s
    measured: Scalar  # m, as the scale reports it
    command: Scalar  # N, before the actuator
    force: Scalar  # N, that acts from k to k+1
    friction: Scalar  # N, without the damping B_S v
    estimate: ObserverEstimate | None


class LoopState(NamedTuple):
    """The state that is carried from one control step to the next."""

    plant: plant.PlantState
    actuator: actuator.ActuatorState
    controller: PyTree
    count: Scalar  # type: ignore[assignment]  # hides `tuple.count`, which a state does not need
    effects: tuple[PyTree, ...] = ()


def initial_state(drive: Drive, controller: Controller, position: Scalar) -> LoopState:
    """Everything at rest at `position` (m), in its precision."""
    state = LoopState(
        plant.at_rest(position),
        actuator.init(drive.actuator),
        controller.init(position),
        jnp.zeros((), jnp.uint32),
        stages.initial_states(drive.effects, jnp.zeros(())),
    )
    return in_precision_of(position, state)


def step_machine(
    drive: Drive, sampling: Sampling, state: LoopState, push: Push, disturbance: Scalar, load: Scalar
) -> tuple[plant.PlantState, tuple[PyTree, ...], Drive]:
    """One period of the table under the actuator's `push`, a `disturbance` and a `load` (N).

    `drive` has its machine effects in it. Returns the table, the states of the effects, and the drive with the friction
    that the effects cause over that period.
    """
    table, effects, force = state.plant, drive.effects, push.mean + disturbance
    if not effects:
        return plant.advance(drive, table, force, load, sampling.period, sampling.plant_steps), (), drive
    time = sampling.period * state.count
    seen = stages.seen_by(drive, time, table.position, table.velocity, table.bristle, push.mean, disturbance, load)
    effect_states, acts = stages.table_action(effects, state.effects, seen, drive, sampling.period)
    effect_states, acts = once((effect_states, acts))
    machine = stages.with_friction_offset(drive, acts)
    steps = stages.plant_substeps(effects, sampling)
    moved = plant.advance(machine, table, force + acts.force, load, sampling.period, steps)
    shift = acts.shift + stages.slope_displacement(drive, push.slope, sampling.period)
    return moved._replace(position=moved.position + shift), effect_states, machine


def step(
    drive: Drive, controller: Controller, sampling: Sampling, key: Array | None, state: LoopState, inputs: Inputs
) -> tuple[LoopState, Frame]:
    """One control period of the closed loop of a drive that has its machine effects in it."""
    table = state.plant
    scale_position = table.position + stages.scale_error(drive.effects, table.position)
    noise = None
    if key is not None:  # the same noise in either precision
        sample = jax.random.normal(jax.random.fold_in(key, state.count), dtype=jnp.float64)
        noise = in_precision_of(scale_position, sample)
    measured = sensor.measure(drive.sensor, scale_position, noise)
    controller_state, command = controller.step(
        state.controller, inputs.reference, measured, state.actuator.applied, sampling.period
    )
    controller_state, command = once((controller_state, command))
    drive_state = actuator.step(drive.actuator, state.actuator, command.force)
    effect_states, applied = stages.actuator_output(drive.effects, state.effects, drive_state.applied, sampling.period)
    before = state._replace(effects=effect_states)
    moved, effect_states, machine = step_machine(drive, sampling, before, applied, inputs.disturbance, inputs.load)
    coefficients = lugre_coefficients(machine.friction, table.velocity, table.bristle, inputs.load)
    frame = Frame(
        position=table.position,
        velocity=table.velocity,
        measured=measured,
        command=command.force,
        force=applied.mean,
        friction=friction_force(coefficients, table.velocity, table.bristle),
        estimate=command.estimate,
    )
    return LoopState(moved, drive_state, controller_state, state.count + 1, effect_states), frame


# In reverse mode a step keeps its carry alone and is computed again on the way back: a fiftieth of the memory, and
# faster too, since it stays in cache. In forward mode it changes nothing.
rematerialised = partial(jax.checkpoint, prevent_cse=False)


Carry = TypeVar("Carry")
Input = TypeVar("Input")
Output = TypeVar("Output")


def _scanned(
    body: Callable[[Carry, Input], tuple[Carry, Output]], begin: Carry, inputs: Input, checkpoint_every: int
) -> tuple[Carry, Output]:
    """`lax.scan` that in reverse mode keeps each `checkpoint_every`-th carry and computes the steps between again."""
    if checkpoint_every == 1:
        return lax.scan(rematerialised(body), begin, inputs)
    if not isinstance(checkpoint_every, int) or checkpoint_every < 1:
        raise ParameterError(f"checkpoint_every must be a whole number from 1 on, got {checkpoint_every!r}")
    blocked = len(jax.tree.leaves(inputs)[0]) // checkpoint_every * checkpoint_every
    chunks = jax.tree.map(lambda signal: signal[:blocked].reshape(-1, checkpoint_every, *signal.shape[1:]), inputs)
    state, frames = lax.scan(
        rematerialised(lambda state, chunk: lax.scan(body, state, chunk, unroll=checkpoint_every)), begin, chunks
    )
    frames = jax.tree.map(lambda signal: signal.reshape(blocked, *signal.shape[2:]), frames)
    if blocked == len(jax.tree.leaves(inputs)[0]):
        return state, frames
    state, last = lax.scan(rematerialised(body), state, jax.tree.map(lambda signal: signal[blocked:], inputs))
    return state, jax.tree.map(lambda some, rest: jnp.concatenate([some, rest]), frames, last)


def rollout(
    drive: Drive,
    controller: Controller,
    inputs: Inputs,
    sampling: Sampling,
    key: Array | None = None,
    every: int = 1,
    begin: LoopState | None = None,
    checkpoint_every: int = 1,
) -> Frame:
    """Roll the loop over `inputs` ([n] each) and record each `every`-th frame: arrays of shape [n // every].

    Pure, for use under `jit`, `vmap`, `grad` and `jacfwd`. `key` seeds the sensor noise; without one there is none.
    `begin` is the state to begin from (see `initial_state`); by default at rest where the reference begins. In reverse
    mode the state of each `checkpoint_every`-th step is kept: 2 takes half the memory of 1, and longer to compile
    (docs/method/numerics.md).
    """
    require_double_precision()
    drive = stages.with_machine_effects(drive, drive.effects)

    def body(state: LoopState, inputs_now: Inputs) -> tuple[LoopState, Frame]:
        return step(drive, controller, sampling, key, state, inputs_now)

    if begin is None:
        begin = initial_state(drive, controller, cast(Array, inputs.reference.position)[0])
    if every == 1:
        return _scanned(body, begin, inputs, checkpoint_every)[1]

    def block(state: LoopState, chunk: Inputs) -> tuple[LoopState, Frame]:
        state, frame = rematerialised(body)(state, jax.tree.map(lambda signal: signal[0], chunk))
        rest = jax.tree.map(lambda signal: signal[1:], chunk)
        state, _ = _scanned(lambda s, inputs_now: (body(s, inputs_now)[0], None), state, rest, checkpoint_every)
        return state, frame

    blocks = len(cast(Array, inputs.load)) // every
    chunks = jax.tree.map(lambda signal: signal[: blocks * every].reshape(blocks, every), inputs)
    return lax.scan(block, begin, chunks)[1]


class Costs(NamedTuple):
    """Running costs of a roll-out over the samples that are counted."""

    rms: Scalar  # m, tracking error
    peak: Scalar  # m, largest tracking error
    command_noise: Scalar  # N, RMS of the command's sample-to-sample change over sqrt 2
    load_error: Scalar | None  # N, RMS of the estimated minus the true load; None where no load is estimated
    saturated: Scalar  # share of the samples at which the command exceeded the force limit
    steps_finite: Scalar  # how many control steps passed before the tracking error left its bound, or was not finite


def running_costs(
    drive: Drive,
    controller: Controller,
    inputs: Inputs,
    counts: Float[Array, " n"],
    sampling: Sampling,
    key: Array | None = None,
    ramp: Ramp | None = None,
    checkpoint_every: int = 1,
    divergence_bound: Scalar = 1.0,
) -> Costs:
    """Roll the loop and keep only its costs, over the samples where `counts` is 1: no memory, for many lanes.

    `ramp` is a load beside that of `inputs`, for lanes whose loads differ by more than a factor. `checkpoint_every`: as
    in `rollout`. A loop whose tracking error is beyond `divergence_bound` (m; see `run.divergence_bound`) has diverged.
    It runs in the precision of its input arrays, all of one kind; its sums are always double.

    Pure, as `rollout`. Differentiable, but for the peak's and the divergence count's kinks.
    """
    require_double_precision()
    drive = stages.with_machine_effects(drive, drive.effects)
    limit = stages.force_limit(drive)
    limit = jnp.inf if limit is None else limit

    def body(carry: PyTree, inputs_now: tuple[Inputs, Scalar]) -> tuple[PyTree, None]:
        state, last, (square, largest, change, load_error, limited, finite) = carry
        now, count = inputs_now
        if ramp is not None:
            now = now._replace(load=now.load + ramp.at(sampling.period * state.count))
        state, frame = step(drive, controller, sampling, key, state, now)
        error = now.reference.position - frame.position
        estimated_load = None if frame.estimate is None else frame.estimate.load
        counts_change = jnp.where(state.count > 1, count, 0.0)  # the first sample has no change of command
        # what does not count may be anything, infinite too
        tracking_error, command_change = (
            jnp.where(count > 0.0, error, 0.0),
            jnp.where(counts_change > 0.0, frame.command - last, 0.0),
        )
        load_deviation = None if estimated_load is None else jnp.where(count > 0.0, estimated_load - now.load, 0.0)
        sums = (
            square + count * tracking_error**2,
            jnp.maximum(largest, count * jnp.abs(tracking_error)),
            change + counts_change * command_change**2,
            None if load_deviation is None else load_error + count * load_deviation**2,
            limited + count * jnp.where(jnp.abs(frame.command) > limit, 1.0, 0.0),
            finite
            + jnp.where((jnp.abs(error) <= divergence_bound) & (finite == state.count - 1), 1, 0).astype(jnp.uint32),
        )
        return (state, frame.command, sums), None

    zero = jnp.zeros(())  # sums stay in double precision, whatever the loop runs in
    begin = initial_state(drive, controller, cast(Array, inputs.reference.position)[0])
    zero_command = jnp.zeros_like(begin.plant.position)
    first_inputs = Inputs(*jax.tree.map(lambda signal: signal[0], tuple(inputs)))
    estimate = jax.eval_shape(lambda: step(drive, controller, sampling, key, begin, first_inputs)[1].estimate)
    load_error = None if estimate is None or estimate.load is None else zero
    sums = (zero, zero, zero, load_error, zero, jnp.zeros((), jnp.uint32))
    (_, _, (square, largest, change, load_error, limited, finite)), _ = _scanned(
        body, (begin, zero_command, sums), (inputs, counts), checkpoint_every
    )
    total = jnp.sum(counts)
    # reciprocals, explicitly: else the compiler may or may not make one of a division, which changes the last bits
    per_sample, per_change = 1.0 / total, 0.5 / (total - counts[0])
    return Costs(
        rms=safe_sqrt(square * per_sample),
        peak=largest,
        command_noise=safe_sqrt(change * per_change),
        load_error=None if load_error is None else safe_sqrt(load_error * per_sample),
        saturated=limited * per_sample,
        steps_finite=finite,
    )


compiled_rollout = eqx.filter_jit(rollout)


def loop_inputs(motion: Motion, load: np.ndarray, disturbance: np.ndarray | None = None) -> Inputs:
    """The inputs of `rollout` from a motion, a load and a disturbance force (N, [n] each; None: no force)."""
    force = np.zeros(len(motion.time)) if disturbance is None else np.asarray(disturbance, float)
    signals = (motion.position, motion.velocity, motion.acceleration, np.asarray(load, float), force)
    arrays = [jnp.asarray(signal, dtype=jnp.float64) for signal in signals]
    return Inputs(Reference(*arrays[:3]), *arrays[3:])


def _whole_number(value: object) -> int | None:
    """The number where it is whole, be it NumPy's; None where it is not. A truth value is no number."""
    is_whole = isinstance(value, SupportsIndex) and not isinstance(value, bool | np.bool_)
    try:
        return operator.index(cast(SupportsIndex, value)) if is_whole else None
    except TypeError:  # an array
        return None


def simulate(
    drive: Drive,
    controller: Controller,
    motion: Motion,
    load: np.ndarray | float = 0.0,
    *,
    sampling: Sampling = Sampling(),
    limits: Limits = Limits(),
    seed: int | None = 0,
    every: int = 1,
) -> Run:
    """Simulate one motion and return every signal, with a status that says whether the run is valid.

    `load` is in N, one number or one per sample. `seed` seeds the sensor noise (None: no noise). `every` keeps each
    n-th sample. Raises `ParameterError` and `MotionError` on bad input; a loop that diverges does not raise but
    returns a `Run` whose `status` says which signal left its bounds and when. Its `notes` say where the controller's
    load estimator does not converge.
    """
    require_double_precision()
    check_drive(drive)
    check(controller)
    require_within(motion, limits)
    if not is_same_rate(motion.rate, sampling.rate):
        raise ParameterError(
            f"the motion is sampled at {motion.rate:g} Hz, the controller runs at {sampling.rate:g} Hz: make them equal"
        )
    stride = _whole_number(every)
    if stride is None or not 1 <= stride < len(motion.time):
        raise ParameterError(f"every must be a whole number from 1 to {len(motion.time) - 1}, got {short_repr(every)}")
    if isinstance(load, str):
        raise MotionError(f"load must be in N, one number or one per sample, got {short_repr(load)}")
    require_shorter(len(motion.time), (*drive.actuator.pipelines, *controller.pipelines))
    require_memory(
        ParameterError,
        f"a run of {len(motion.time)} samples",
        DOUBLE_BYTES * len(motion.time) * (INPUT_ARRAYS + OUTPUT_ARRAYS / stride),
        "shorten the motion, lower sampling.rate, or keep each n-th sample (`every`)",
    )
    loads = validated_load(drive, np.full(len(motion.time), float(load)) if np.ndim(load) == 0 else load, motion.time)
    require_resolved_friction(drive, float(np.max(loads)), float(np.max(np.abs(motion.velocity))), sampling)
    feasibility.require_feasible(
        drive, feasibility.motion_envelope(motion.position, motion.velocity, loads, sampling.period)
    )
    notes = tuple(convergence_warnings(controller, motion, loads, sampling.period))
    number = None if seed is None else _whole_number(seed)
    if seed is not None and (number is None or not -(2**63) <= number < 2**63):
        raise ParameterError(f"seed must be a whole number of 64 bits, or None for no noise, got {short_repr(seed)}")
    key = jax.random.key(number) if number is not None and float(drive.sensor.noise) > 0 else None

    def run_machine(machine: Drive) -> tuple[Run, float | None]:
        frames = compiled_rollout(*as_arrays((machine, controller)), loop_inputs(motion, loads), sampling, key, stride)
        limit = stages.force_limit(machine)
        run = replace(Run.from_frames(motion, loads, frames, stride), notes=notes)
        return run, None if limit is None else float(limit)

    def converges_without(effects: Sequence[Effect]) -> bool:
        machine = replace(
            drive,
            effects=tuple(effect for effect in drive.effects if not any(effect is removed for removed in effects)),
        )
        run, limit = run_machine(machine)
        return with_status(run, limits, limit).status.ok

    run, limit = run_machine(drive)
    assessed = with_status(run, limits, limit)
    if assessed.status.ok or assessed.status.code == "saturated" or not drive.effects:
        return assessed
    # the gains are the cause only if the loop diverges without the effects, too
    single = [[effect] for effect in drive.effects]
    responsible = next((group for group in (*single, list(drive.effects)) if converges_without(group)), [])
    return with_status(run, limits, limit, [effect.name for effect in responsible])
