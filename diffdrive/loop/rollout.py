"""The loop rolled over a motion: its frames, as a pure function of drive, controller and inputs."""

from collections.abc import Callable
from functools import partial
from typing import TypeVar, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Float

from diffdrive.controllers import Controller, Reference
from diffdrive.effects import stages
from diffdrive.errors import ParameterError
from diffdrive.loop.step import Frame, Inputs, LoopState, initial_state, step
from diffdrive.model.friction import resolvable
from diffdrive.model.parameters import Drive, Sampling
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import require_double_precision

# In reverse mode a step keeps its carry alone and is computed again on the way back: a fiftieth of the memory, and
# faster too, since it stays in cache. In forward mode it changes nothing.
rematerialised = partial(jax.checkpoint, prevent_cse=False)


Carry = TypeVar("Carry")
Input = TypeVar("Input")
Output = TypeVar("Output")


def scanned(
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


def rollout_loop(
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
    drive, controller = resolvable((stages.with_machine_effects(drive, drive.effects), controller))

    def body(state: LoopState, inputs_now: Inputs) -> tuple[LoopState, Frame]:
        return step(drive, controller, sampling, key, state, inputs_now)

    if begin is None:
        begin = initial_state(drive, controller, cast(Array, inputs.reference.position)[0])
    if every == 1:
        return scanned(body, begin, inputs, checkpoint_every)[1]

    def block(state: LoopState, chunk: Inputs) -> tuple[LoopState, Frame]:
        state, frame = rematerialised(body)(state, jax.tree.map(lambda signal: signal[0], chunk))
        rest = jax.tree.map(lambda signal: signal[1:], chunk)
        state, _ = scanned(lambda s, inputs_now: (body(s, inputs_now)[0], None), state, rest, checkpoint_every)
        return state, frame

    blocks = len(cast(Array, inputs.load)) // every
    chunks = jax.tree.map(lambda signal: signal[: blocks * every].reshape(blocks, every), inputs)
    return lax.scan(block, begin, chunks)[1]


compiled_rollout = eqx.filter_jit(rollout_loop)


def loop_inputs(
    motion: Motion,
    load: Float[Array, " n"] | Float[np.ndarray, " n"],
    disturbance: Float[np.ndarray, " n"] | None = None,
) -> Inputs:
    """The inputs of `rollout_loop` from a motion, a load and a disturbance force (N, [n] each; None: no force)."""
    force = np.zeros(len(motion.time)) if disturbance is None else disturbance
    signals = (motion.position, motion.velocity, motion.acceleration, load, force)
    arrays = [jnp.asarray(signal, dtype=jnp.float64) for signal in signals]
    return Inputs(Reference(*arrays[:3]), *arrays[3:])
