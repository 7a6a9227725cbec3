"""What keeps a machine of a sweep from being, found before any of them runs: hours later would be late."""

from collections.abc import Callable, Iterable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from diffdrive.effects.base import Envelope
from diffdrive.effects.feasibility import limits_envelope, motion_envelope, require_feasible
from diffdrive.errors import MotionError, ParameterError
from diffdrive.model.parameters import Drive
from diffdrive.motion.load import Ramp, require_resolved_friction
from tuning.sweeps.duty_cycles import DutyCycle
from tuning.sweeps.plan import SweepPlan

Numbers = Int[np.ndarray, " n"]


def require_possible(plan: SweepPlan, parts: Iterable[int]) -> None:
    """Every machine of these parts can be. Raises `ParameterError` that names one that cannot.

    Where settings of motions vary, those machines are looked at that are nearest to their ends.
    """
    for part in parts:
        require_machines(plan, plan.numbers(part))
        for motion in plan.motions if plan.has_own_cycles else ():
            machine_cycles(plan, plan.corner_numbers(part), motion)


def require_machines(plan: SweepPlan, numbers: Numbers) -> None:
    """These machines can be, but for settings that vary. Raises `ParameterError` that names one that cannot."""
    cycles = _nominal_cycles(plan)
    least = min((float(np.min(cycle.load)) for cycle in cycles), default=np.inf)
    machines, ramps = _require_buildable(plan, numbers)
    _require_on_guides(numbers, machines, ramps, np.full(len(numbers), least), lambda _: cycles)


def machine_cycles(plan: SweepPlan, numbers: Numbers, motion: str) -> list[DutyCycle]:
    """What machines of one part go through. Raises `ParameterError` that names one that cannot be."""
    cycles = plan.cycles(numbers, motion)
    least = np.array([np.min(cycle.load) for cycle in cycles])
    machines, ramps = _build(plan, numbers)
    _require_on_guides(numbers, machines, ramps, least, lambda k: [cycles[k]])
    return cycles


def _nominal_cycles(plan: SweepPlan) -> list[DutyCycle]:
    """What all machines go through but for settings of motions; nothing where the load over time varies."""
    return [] if plan.varies("load") else [plan.nominal_cycle(motion) for motion in plan.motions]


def _require_buildable(plan: SweepPlan, numbers: Numbers) -> tuple[Drive, Ramp]:
    """These machines. Raises `ParameterError` that names the first that cannot be built."""
    try:
        return _build(plan, numbers)
    except ParameterError as found:
        problem = found
    while len(numbers) > 1:
        half = len(numbers) // 2
        try:
            _build(plan, numbers[:half])
            numbers = numbers[half:]
        except ParameterError as found:
            numbers, problem = numbers[:half], found
    raise ParameterError(f"sweep: machine {numbers[0]} cannot be: {problem}") from None


def _build(plan: SweepPlan, numbers: Numbers) -> tuple[Drive, Ramp]:
    machine, ramp, _, _ = plan.machines(numbers)
    envelope = _envelope(plan)
    _require_ordered(ramp)
    require_feasible(machine, envelope)
    highest = max((float(np.max(cycle.load)) for cycle in _nominal_cycles(plan)), default=0.0)
    highest_load = jnp.asarray(highest + ramp.load + np.maximum(ramp.change, 0.0))
    try:
        require_resolved_friction(machine, highest_load, envelope.speed or 0.0, plan.axis.sampling)
    except MotionError as problem:
        raise ParameterError(str(problem)) from None
    return machine, ramp


def _envelope(plan: SweepPlan) -> Envelope:
    """Within what the machines move: a motion that varies may go wherever the limits let it."""
    if plan.varies("motion"):
        return limits_envelope(plan.axis.limits, plan.axis.sampling)
    position, velocity = (
        np.concatenate([getattr(motion, name) for motion in plan.motions.values()]) for name in ("position", "velocity")
    )
    every = motion_envelope(position, velocity, np.zeros(1), plan.axis.sampling.period)
    return every._replace(duration=max(motion.duration for motion in plan.motions.values()))


def _require_ordered(ramp: Ramp) -> None:
    """Raises `ParameterError` where a load's change ends before it begins."""
    if np.any((ramp.begin > ramp.end) & (ramp.change != 0.0)):
        raise ParameterError(
            "its load.change.begin comes after its load.change.end: let them vary in ranges that do not overlap"
        )


def _require_on_guides(
    numbers: Numbers,
    drives: Drive,
    ramps: Ramp,
    least: Float[np.ndarray, " n"],
    cycles: Callable[[int], Sequence[DutyCycle]],
) -> None:
    """Raises `ParameterError` that names the first machine whose load lifts its table off the guides.

    `least` are the loads (N) over time at their least, `cycles` those of the k-th machine: where the least of all
    loads at once would be too little, it is looked when each acts.
    """
    bounds = -np.broadcast_to(np.asarray(drives.friction.initial_load), len(numbers))
    for k in np.flatnonzero(np.asarray(least + ramps.load + np.minimum(ramps.change, 0.0)) <= bounds):
        ramp = jax.tree.map(lambda leaf, k=k: leaf[k], ramps)
        least_loads = [
            np.min(load + np.asarray(ramp.at(motion.time - motion.time[0]))) for motion, load in cycles(int(k))
        ]
        if least_loads and min(least_loads) <= bounds[k]:
            raise ParameterError(
                f"sweep: machine {numbers[k]} cannot be: a load of {min(least_loads):g} N lifts the table off its "
                f"guides: it must stay above minus the initial load, {bounds[k]:g} N"
            )
