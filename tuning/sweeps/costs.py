"""What comes of the machines of a sweep: their errors under every controller, on every motion."""

from collections.abc import Iterable
from types import EllipsisType
from typing import NamedTuple

import jax
import numpy as np
import pyarrow as pa

from diffdrive.errors import ParameterError
from diffdrive.loop.costs import Costs
from diffdrive.support.resources import require_memory
from tuning.sweeps.duty_cycles import shared_cycle, stacked_cycles
from tuning.sweeps.engine import LaneCycle, block_size, lane_costs
from tuning.sweeps.machines import lane
from tuning.sweeps.plan import SweepPlan
from tuning.sweeps.possible import machine_cycles

BYTES_PER_STEP, MAX_BYTES = 160.0, 2e9  # bytes a step of a machine with a cycle of its own, and of all at once


class SweepCosts(NamedTuple):
    """What came of machines, [n] each."""

    costs: Costs
    diverged_at: np.ndarray  # s from the beginning; NaN of a machine that did not


def part_costs(plan: SweepPlan, part: int) -> pa.Table:
    """The machines of a part under every controller on every motion: one row for each."""
    numbers, tables = plan.numbers(part), []
    unknown = pa.nulls(len(numbers), pa.float64())
    for motion in plan.motions:
        values = plan.values(numbers, motion)
        for controller, (found, diverged_at) in costs_of(plan, numbers, motion, plan.controllers).items():
            tables.append(
                pa.table(
                    {
                        "machine": numbers,
                        "controller": [controller] * len(numbers),
                        "motion": [motion] * len(numbers),
                        **values,
                        "rms_m": found.rms,
                        "peak_m": found.peak,
                        "command_noise_N": found.command_noise,
                        "load_error_N": unknown if found.load_error is None else found.load_error,
                        "saturated": found.saturated,
                        "diverged": ~np.isnan(diverged_at),
                        "diverged_at_s": pa.array(diverged_at, from_pandas=True),
                    }
                )
            )
    return pa.concat_tables(tables)


def costs_of(plan: SweepPlan, numbers: np.ndarray, motion: str, controllers: Iterable[str]) -> dict[str, SweepCosts]:
    """What comes of machines of one part; to the last bit the same whichever others stand beside them."""
    drives, ramps, _, keys = plan.machines(numbers)
    sampling, limits = plan.axis.sampling, plan.axis.limits

    def under(
        controller: str, cycle: LaneCycle, samples: np.ndarray, some: np.ndarray | EllipsisType = ...
    ) -> SweepCosts:
        some_ramps, some_keys = jax.tree.map(lambda leaf: leaf[some], (ramps, keys))
        control = plan.controllers[controller]
        found = lane_costs(lane(drives, some), some_ramps, some_keys, control, cycle, sampling, plan.precision)
        return _outcome(found, samples, sampling.period)

    if not plan.has_own_cycles:
        nominal = plan.nominal_cycle(motion)
        cycle = shared_cycle(nominal, plan.settle, limits)
        return {name: under(name, cycle, np.full(len(numbers), len(nominal.load))) for name in controllers}
    groups: dict[str, list[SweepCosts]] = {name: [] for name in controllers}
    for some in np.split(np.arange(len(numbers)), np.arange(0, len(numbers), machines_at_once(plan, motion))[1:]):
        cycles = machine_cycles(plan, numbers[some], motion)
        samples = np.array([len(cycle.load) for cycle in cycles])
        stacked = stacked_cycles(cycles, plan.settle, limits)
        for name, group in groups.items():
            group.append(under(name, stacked, samples, some))
    return {name: jax.tree.map(lambda *parts: np.concatenate(parts), *group) for name, group in groups.items()}


def machines_at_once(plan: SweepPlan, motion: str) -> int:
    """How many machines with duty cycles of their own are held in memory: whole blocks, as many as it bears."""
    of_block = block_size(own_cycles=True)
    longest = max(len(cycle.load) for cycle in plan.cycles(plan.corner_numbers(), motion))  # about
    of_one = BYTES_PER_STEP * longest * of_block
    require_memory(
        ParameterError,
        f"{motion}: {of_block} machines side by side, each on its own duty cycle of up to {longest} samples,",
        of_one,
        "shorten the motion, or lower sampling.rate",
    )
    return of_block * max(1, min(int(MAX_BYTES / of_one), len(jax.devices())))


def _outcome(costs: Costs, samples: np.ndarray, period: float) -> SweepCosts:
    """A machine diverged that did not stay to the end of its own cycle."""
    return SweepCosts(costs, np.where(costs.steps_finite >= samples, np.nan, costs.steps_finite * period))
