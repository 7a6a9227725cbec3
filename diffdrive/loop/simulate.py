"""One motion simulated: the input is checked, and a loop that diverges is blamed on what makes it."""

import operator
from collections.abc import Sequence
from dataclasses import replace
from typing import SupportsIndex, cast

import jax
import numpy as np

from diffdrive.controllers import Controller
from diffdrive.controllers.base import require_rate
from diffdrive.effects import feasibility, stages
from diffdrive.effects.base import Effect
from diffdrive.errors import MotionError, ParameterError
from diffdrive.loop.convergence import convergence_warnings
from diffdrive.loop.rollout import compiled_rollout, loop_inputs
from diffdrive.loop.run import Run, with_status
from diffdrive.model.parameters import Drive, Sampling, check_drive
from diffdrive.model.quantity import check
from diffdrive.motion.load import require_resolved_friction, validated_load
from diffdrive.motion.motion import Limits, Motion, require_within
from diffdrive.numerics.arrays import as_arrays, require_double_precision
from diffdrive.numerics.pipeline import require_shorter
from diffdrive.support.messages import short_repr
from diffdrive.support.rates import require_same_rate
from diffdrive.support.resources import require_memory

INPUT_ARRAYS, OUTPUT_ARRAYS, DOUBLE_BYTES = (
    8,
    14,
    8,
)  # arrays over the samples of a run, those over the kept ones, and bytes of a number


def _whole_number(value: object) -> int | None:
    """The number where it is whole, be it NumPy's; None where it is not. A truth value is no number."""
    is_whole = isinstance(value, SupportsIndex) and not isinstance(value, bool | np.bool_)
    try:
        return operator.index(cast(SupportsIndex, value)) if is_whole else None
    except TypeError:  # an array
        return None


def simulate_loop(
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
    require_rate(controller, sampling.rate)
    require_within(motion, limits)
    require_same_rate(f"motion '{motion.name}'", motion.rate, "the axis", sampling.rate)
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
    key = jax.random.key(number) if number is not None and drive.has_noise else None

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
