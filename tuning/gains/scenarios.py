"""What a controller is tuned on: motions, loads, machines and noise, side by side as the lanes of one program."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffdrive.controllers import Controller
from diffdrive.effects.stages import force_limit
from diffdrive.errors import MotionError, ParameterError
from diffdrive.loop.rollout import loop_inputs, rollout_loop
from diffdrive.loop.smooth import smooth
from diffdrive.loop.step import Inputs
from diffdrive.model.parameters import Drive, Sampling, Sensor
from diffdrive.motion.motion import Motion
from diffdrive.numerics.arrays import as_arrays
from diffdrive.support.rates import is_same_rate


@dataclass(frozen=True)
class Scenario:
    """One motion of one machine under one load (N, one number or one per sample), with one sequence of noise."""

    name: str
    drive: Drive
    motion: Motion
    load: Float[np.ndarray, " n"] | float = 0.0
    seed: int = 0


class EnsembleSignals(NamedTuple):
    """What a roll-out shows after it has settled, [lanes, n] each; all of them are better when smaller."""

    error: Float[Array, "lanes n"]  # m, tracking error
    command_change: Float[Array, "lanes n"]  # N, of the command from sample to sample, over sqrt 2
    force_excess: Float[Array, "lanes n"] | None  # N, of the command over the force limit; None where there is none
    load_error: Float[Array, "lanes n"] | None  # N; None where no load is estimated

    def require_load_error(self, argument: str) -> Float[Array, "lanes n"]:
        """The load error (N); raises `ParameterError` where the controller shows none that could be kept or lowered."""
        if self.load_error is None:
            raise ParameterError(f"{argument}: load_error: this controller estimates no load, so that it has no error")
        return self.load_error


class Ensemble(eqx.Module):
    """Scenarios as lanes, on the smooth variants of their machines."""

    drives: Drive  # every number [lanes]
    inputs: Inputs  # every signal [lanes, n]
    seeds: Array  # [lanes]
    sampling: Sampling = eqx.field(static=True)
    first_counted: int = eqx.field(static=True)

    def signals(self, controller: Controller) -> EnsembleSignals:
        """Roll every lane. Pure: for use under `jit`, `vmap` and `jacfwd`."""

        def lane_signals(drive: Drive, inputs: Inputs, seed: Array) -> EnsembleSignals:
            frame = rollout_loop(drive, controller, inputs, self.sampling, jax.random.key(seed))
            late, before = slice(self.first_counted, None), slice(self.first_counted - 1, None)
            limit = force_limit(drive)
            command, load = jnp.asarray(frame.command), None if frame.estimate is None else frame.estimate.load
            return EnsembleSignals(
                error=jnp.asarray(inputs.reference.position - frame.table_position)[late],
                command_change=jnp.diff(command[before]) / np.sqrt(2.0),
                force_excess=None if limit is None else jnp.maximum(jnp.abs(command[late]) - limit, 0.0),
                load_error=None if load is None else jnp.asarray(load - inputs.load)[late],
            )

        return jax.vmap(lane_signals)(self.drives, self.inputs, self.seeds)


def ensemble(scenarios: Sequence[Scenario], sampling: Sampling, *, settle: float) -> Ensemble:
    """The lanes of these scenarios; what they cost counts from `settle` (s) on.

    The quantiser of an encoder is replaced by the white noise of the same variance, resolution^2 / 12. Raises
    `ParameterError` where the machines differ in kind (delay samples, a limit on one alone) and `MotionError` where the
    motions differ in length or rate.
    """
    if not scenarios:
        raise ParameterError("no scenario to tune on")
    first = scenarios[0].motion
    for scenario in scenarios:
        if len(scenario.motion.time) != len(first.time) or not is_same_rate(scenario.motion.rate, sampling.rate):
            raise MotionError(
                f"{scenario.name}: {len(scenario.motion.time)} samples at {scenario.motion.rate:g} Hz beside "
                f"{len(first.time)} at {sampling.rate:g} Hz: scenarios are simulated side by side, so make their "
                "motions equally long"
            )
    settled = max(1, round(settle * sampling.rate))
    if settled >= len(first.time) - 1:
        raise MotionError(f"nothing is left of {first.time[-1]:g} s of motion after {settle:g} s to settle")
    drives = [as_arrays(smooth(_with_quantisation_noise(scenario.drive))) for scenario in scenarios]
    if len({jax.tree.structure(drive) for drive in drives}) > 1:
        raise ParameterError(
            "the machines of the scenarios differ in kind (delay samples, force limit, resolution, Stribeck exponent): "
            "tune on machines that differ in numbers alone"
        )
    loads = [np.broadcast_to(np.asarray(scenario.load, float), first.time.shape) for scenario in scenarios]
    inputs = [loop_inputs(scenario.motion, load) for scenario, load in zip(scenarios, loads, strict=True)]
    return Ensemble(
        drives=_stacked(drives),
        inputs=_stacked(inputs),
        seeds=jnp.asarray([scenario.seed for scenario in scenarios]),
        sampling=sampling,
        first_counted=settled,
    )


Tree = TypeVar("Tree")


def _stacked(trees: Sequence[Tree]) -> Tree:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _with_quantisation_noise(drive: Drive) -> Drive:
    motor = drive.motor_encoder
    return replace(drive, sensor=_dithered(drive.sensor), motor_encoder=None if motor is None else _dithered(motor))


def _dithered(encoder: Sensor) -> Sensor:
    """The encoder with white noise in the place of its steps."""
    rounding = 0.0 if encoder.resolution is None else float(encoder.resolution) ** 2 / 12
    return Sensor(None, float(np.sqrt(float(encoder.noise) ** 2 + rounding)))
