"""A sweep as it was asked for, and the costs of any part of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import EllipsisType
from typing import Any, NamedTuple, get_args

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
from jaxtyping import Array

from diffdrive.axis import Axis
from diffdrive.controllers import Controller
from diffdrive.effects.base import Envelope
from diffdrive.effects.feasibility import limits_envelope, motion_envelope, require_feasible
from diffdrive.errors import MotionError, ParameterError
from diffdrive.loop.costs import Costs
from diffdrive.model.parameters import Drive
from diffdrive.motion.load import Ramp, require_resolved_friction
from diffdrive.motion.motion import Motion, require_within
from diffdrive.motion.text import Recipe, load_recipe, parse_load, require_choice, require_longer_than
from diffdrive.numerics.arrays import as_arrays, require_double_precision
from diffdrive.runtime import arithmetic_signature
from diffdrive.support.rates import require_same_rate
from diffdrive.support.resources import require_memory
from tuning.store.edition import code_digest
from tuning.store.store import digest
from tuning.sweeps.duty_cycles import (
    DutyCycle,
    DutyCycles,
    at_corners,
    is_cycle_setting,
    shared_cycle,
    stacked_cycles,
    variable_settings,
)
from tuning.sweeps.engine import LEAST_IN_A_PART, LaneCycle, Precision, block_size, lane_costs
from tuning.sweeps.machines import Values, lane, machines
from tuning.sweeps.possible import require_buildable, require_on_guides, require_ordered
from tuning.sweeps.samples import Method, correlate, correlation_root, unit_samples
from tuning.sweeps.varied import VariedQuantity, parse_varied

BYTES_PER_STEP, MAX_BYTES = 160.0, 2e9  # bytes a step of a machine with a cycle of its own, and of all at once


class SweepCosts(NamedTuple):
    """What came of machines, [n] each."""

    costs: Costs
    diverged_at: np.ndarray  # s from the beginning; NaN of a machine that did not


@dataclass(frozen=True)
class SweepPlan:
    """The machines of a sweep, and what each goes through.

    Every controller follows every motion on the same machines under the same loads and noise (common random numbers).
    """

    axis: Axis
    controllers: Mapping[str, Controller]
    motions: Mapping[str, Motion]
    varied: tuple[VariedQuantity, ...]
    samples: int
    method: Method = "sobol"
    seed: int = 0
    recipes: Mapping[str, Recipe[Motion] | None] = field(default_factory=dict)  # of the motions whose settings may vary
    load: str = "0"  # over time, as `motion.text.parse_load` takes it; a load that varies is added to it
    settle: float = 0.0  # s at the start that do not count
    correlation: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    most_in_a_part: int = LEAST_IN_A_PART  # a power of two
    precision: Precision = "double"

    @classmethod
    def of(
        cls, axis: Axis, controllers: Mapping[str, Controller], motions: Mapping[str, Motion],
        vary: tuple[str, ...], samples: int, **more: Any,
    ) -> "SweepPlan":  # fmt: skip
        """From the texts of `varied.parse_varied`. Raises `ParameterError` or `MotionError` for one that cannot be."""
        require_double_precision()
        require_choice("method", "method", more.get("method", "sobol"), get_args(Method))
        require_choice("precision", "precision", more.get("precision", "double"), get_args(Precision))
        recipes = more.get("recipes", {})
        known = variable_settings({name: recipes.get(name) for name in motions}, load_recipe(more.get("load", "0")))
        varied = tuple(parse_varied(text, axis.drive, known) for text in vary)
        names = [quantity.name for quantity in varied]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ParameterError(f"vary: {', '.join(twice)} is given more than once")
        both = [name for name in names if {f"{name}.positive", f"{name}.negative"} & set(names)]
        if both:
            raise ParameterError(f"vary {both[0]}: stands for both directions, one of which is varied beside it")
        plan = cls(axis, controllers, motions, varied, samples, **more)
        if samples < 1:
            raise ParameterError(f"sweep: at least one machine is needed, got {samples}")
        if set(names) & {"load.change.begin", "load.change.end"} and "load.change" not in names:
            raise ParameterError("vary load.change.begin, load.change.end: load.change does not vary: give it, too")
        for name, motion in motions.items():
            if not plan._varies("motion"):  # else none of the machines may run that one
                require_within(motion, axis.limits)
                require_longer_than(plan.settle, name, motion)
            require_same_rate(name, motion.rate, "the axis", axis.rate)
        if not 0 <= plan.seed < 2**63:
            raise ParameterError(f"sweep: seed must be from 0 to 2^63 - 1, got {plan.seed}")
        correlation_root(plan.correlation, names)
        return plan

    @cached_property
    def _setting_indices(self) -> list[int]:
        """Which of the quantities that vary are settings of the motions and of the load over time."""
        return [k for k, quantity in enumerate(self.varied) if is_cycle_setting(quantity.name)]

    @cached_property
    def duty_cycles(self) -> DutyCycles:
        """Motions and load over time."""
        varied = tuple(self.varied[k] for k in self._setting_indices)
        return DutyCycles(self.motions, self.recipes, self.load, self.axis.sampling.rate, varied)

    def _varies(self, of: str) -> bool:
        """Whether settings of the motions, or of the load, vary."""
        return any(quantity.name.startswith(f"{of}.") for quantity in self.duty_cycles.varied)

    def machine_cycles(self, numbers: np.ndarray, motion: str) -> list[DutyCycle]:
        """What machines of one part go through. Raises `ParameterError` that names one that cannot."""
        values = self.duty_cycles.values(motion, self._unit_samples(numbers)[:, self._setting_indices])
        found = []
        for k, number in enumerate(numbers):
            try:
                cycle = self.duty_cycles.cycle(motion, {name: value[k] for name, value in values.items()})
                require_within(cycle.motion, self.axis.limits)
                require_longer_than(self.settle, motion, cycle.motion)
            except (MotionError, ParameterError) as problem:
                raise ParameterError(f"sweep: machine {number} cannot be: {problem}") from None
            found.append(cycle)
        least = np.array([np.min(cycle.load) for cycle in found])
        machines, ramps = self._build(numbers)
        require_on_guides(numbers, machines, ramps, least, lambda k: [found[k]])
        return found

    def require_possible(self, parts: Iterable[int]) -> None:
        """Every machine of these parts can be. Raises `ParameterError` that names one that cannot.

        Where settings of motions vary, those machines are looked at that are nearest to their ends.
        """
        nominal = self.nominal_cycles
        for part in parts:
            self.require_machines(self.numbers(part), nominal)
            for motion in self.motions if self._setting_indices else ():
                self.corner_cycles(motion, part)

    def require_machines(self, numbers: np.ndarray, cycles: Sequence[DutyCycle]) -> None:
        """These machines can be, on cycles that are the same for all. Raises `ParameterError` that names one."""
        least = min((float(np.min(cycle.load)) for cycle in cycles), default=np.inf)
        machines, ramps = require_buildable(numbers, self._build)
        require_on_guides(numbers, machines, ramps, np.full(len(numbers), least), lambda _: cycles)

    def _build(self, numbers: np.ndarray) -> tuple[Drive, Ramp]:
        machine, ramp, _, _ = self.machines(numbers)
        require_ordered(ramp)
        require_feasible(machine, self._envelope)
        highest = jnp.asarray(self._highest_load + ramp.load + np.maximum(ramp.change, 0.0))
        try:
            require_resolved_friction(machine, highest, self._envelope.speed or 0.0, self.axis.sampling)
        except MotionError as problem:
            raise ParameterError(str(problem)) from None
        return machine, ramp

    @cached_property
    def _highest_load(self) -> float:
        """The highest load over time (N), beside what varies of it."""
        return max((float(np.max(cycle.load)) for cycle in self.nominal_cycles), default=0.0)

    @cached_property
    def _envelope(self) -> Envelope:
        """Within what the machines move: a motion that varies may go wherever the limits let it."""
        if self._varies("motion"):
            return limits_envelope(self.axis.limits, self.axis.sampling)
        position, velocity = (
            np.concatenate([getattr(motion, name) for motion in self.motions.values()])
            for name in ("position", "velocity")
        )
        every = motion_envelope(position, velocity, np.zeros(1), self.axis.sampling.period)
        return every._replace(duration=max(motion.duration for motion in self.motions.values()))

    @property
    def nominal_cycles(self) -> list[DutyCycle]:
        """What all machines go through but for settings of motions; nothing where the load over time varies."""
        return (
            [] if self._varies("load") else [DutyCycle(motion, self.loads(motion)) for motion in self.motions.values()]
        )

    def corner_cycles(self, motion: str, part: int = 0) -> list[DutyCycle]:
        """What the machines nearest to the ends of settings go through."""
        drawn = self.unit_samples(part)[:, self._setting_indices]
        return self.machine_cycles(self.numbers(part)[at_corners(drawn)], motion)

    def loads(self, motion: Motion) -> np.ndarray:
        """The load (N) along a motion, beside what varies."""
        return parse_load(self.load, motion.time)

    def extreme_cycles(self, motion: str) -> list[DutyCycle]:
        """What comes at worst: the ends of the settings, with the least and the most of the load that varies."""
        planned = self.motions[motion]
        cycles = self.corner_cycles(motion) if self._setting_indices else [DutyCycle(planned, self.loads(planned))]
        ends = {quantity.name: quantity.quantile(np.array([0.0, 1.0])) for quantity in self.varied}
        behind = np.append(ends.get("load.change", []), 0.0)
        more = [load + change for load in ends.get("load", [0.0]) for change in behind]
        return [DutyCycle(motion, np.concatenate([load + each for each in more])) for motion, load in cycles]

    @cached_property
    def _correlation_root(self) -> np.ndarray | None:
        return correlation_root(self.correlation, [quantity.name for quantity in self.varied])

    @property
    def part_size(self) -> int:
        """Machines in a part, a power of two."""
        return min(self.most_in_a_part, 1 << (self.samples - 1).bit_length())

    @property
    def parts(self) -> int:
        """How many parts."""
        return -(-self.samples // self.part_size)

    def unit_samples(self, part: int) -> np.ndarray:
        """Shares of the probability of the machines of a part, [n, d]."""
        count = len(self.numbers(part))
        drawn = unit_samples(self.method, len(self.varied), self.seed, part, self.part_size, count)
        return drawn if self._correlation_root is None else correlate(drawn, self._correlation_root)

    def numbers(self, part: int) -> np.ndarray:
        """Numbers of the machines of a part."""
        return np.arange(part * self.part_size, min(self.samples, (part + 1) * self.part_size))

    def keys(self, numbers: np.ndarray) -> Array | None:
        """Keys of the measuring noise of these machines; None where the scale has none."""
        if not float(self.axis.drive.sensor.noise) > 0.0 and not any(
            quantity.name == "sensor.noise" for quantity in self.varied
        ):
            return None
        base = jax.random.key(self.seed)
        return jax.vmap(lambda number: jax.random.fold_in(base, number))(jnp.asarray(numbers))

    def _unit_samples(self, numbers: np.ndarray) -> np.ndarray:
        """Those of some machines of one part."""
        part = int(numbers[0]) // self.part_size
        return self.unit_samples(part)[numbers - part * self.part_size]

    def machines(self, numbers: np.ndarray) -> tuple[Drive, Ramp, Values, Array | None]:
        """Machines of one part by their numbers: drives, loads, the values of what varies, the keys of their noise."""
        own = [k for k in range(len(self.varied)) if k not in self._setting_indices]
        varied = [self.varied[k] for k in own]
        return *machines(self.axis.drive, varied, self._unit_samples(numbers)[:, own]), self.keys(numbers)

    def values(self, numbers: np.ndarray, motion: str) -> Values:
        """The values of what varies of some machines of one part, [n] each, in the order in which it was given."""
        drawn, (_, _, found, _) = self._unit_samples(numbers)[:, self._setting_indices], self.machines(numbers)
        found |= self.duty_cycles.values(motion, drawn)
        return {quantity.name: found[quantity.name] for quantity in self.varied}

    def costs_of(self, numbers: np.ndarray, motion: str, controllers: Iterable[str]) -> dict[str, SweepCosts]:
        """What comes of machines of one part; to the last bit the same whichever others stand beside them."""
        drives, ramps, _, keys = self.machines(numbers)
        sampling, limits = self.axis.sampling, self.axis.limits

        def under(
            controller: str, cycle: LaneCycle, samples: np.ndarray, some: np.ndarray | EllipsisType = ...
        ) -> SweepCosts:
            some_ramps, some_keys = jax.tree.map(lambda leaf: leaf[some], (ramps, keys))
            control = self.controllers[controller]
            found = lane_costs(lane(drives, some), some_ramps, some_keys, control, cycle, sampling, self.precision)
            return _outcome(found, samples, sampling.period)

        if not self._setting_indices:
            planned = self.motions[motion]
            cycle = shared_cycle(DutyCycle(planned, self.loads(planned)), self.settle, limits)
            return {name: under(name, cycle, np.full(len(numbers), len(planned.time))) for name in controllers}
        groups: dict[str, list[SweepCosts]] = {name: [] for name in controllers}
        for some in np.split(np.arange(len(numbers)), np.arange(0, len(numbers), self._machines_at_once(motion))[1:]):
            cycles = self.machine_cycles(numbers[some], motion)
            samples = np.array([len(cycle.load) for cycle in cycles])
            stacked = stacked_cycles(cycles, self.settle, limits)
            for name, group in groups.items():
                group.append(under(name, stacked, samples, some))
        return {name: jax.tree.map(lambda *parts: np.concatenate(parts), *group) for name, group in groups.items()}

    @cached_property
    def _longest_cycles(self) -> dict[str, int]:
        """Samples of the longest cycle of each motion, about."""
        return {motion: max(len(cycle.load) for cycle in self.corner_cycles(motion)) for motion in self.motions}

    def _machines_at_once(self, motion: str) -> int:
        """How many machines with cycles of their own are held in memory: whole blocks, as many as it bears."""
        of_one = BYTES_PER_STEP * self._longest_cycles[motion] * block_size(own_cycles=True)
        require_memory(
            ParameterError,
            f"{motion}: {block_size(own_cycles=True)} machines side by side, each on its own duty cycle of up to "
            f"{self._longest_cycles[motion]} samples,",
            of_one,
            "shorten the motion, or lower sampling.rate",
        )
        blocks = int(MAX_BYTES / of_one)
        return block_size(own_cycles=True) * max(1, min(blocks, len(jax.devices())))

    def costs(self, part: int) -> pa.Table:
        """The machines of a part under every controller on every motion: one row for each."""
        numbers, tables = self.numbers(part), []
        unknown = pa.nulls(len(numbers), pa.float64())
        for motion in self.motions:
            values = self.values(numbers, motion)
            for controller, (found, diverged_at) in self.costs_of(numbers, motion, self.controllers).items():
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

    def axis_of(self, drive: Drive) -> Axis:
        """The axis with another drive in it: what a machine's drive file says."""
        return replace(self.axis, drive=drive)

    @property
    def units(self) -> dict[str, str]:
        """What varies, with its unit."""
        return {quantity.name: quantity.unit for quantity in self.varied}

    def identity(self) -> str:
        """What tells this sweep from any other: everything that its numbers hang on."""
        definitions = (SweepPlan, DutyCycles, lane_costs, machines, parse_varied, unit_samples)
        recipes = (None if recipe is None else (recipe.kind, recipe.settings) for recipe in self.recipes.values())
        return digest(
            code_digest(*(definition.__module__ for definition in definitions)),
            arithmetic_signature(),
            *(self.method, self.seed, self.samples, self.part_size, self.load, self.settle, self.precision),
            [quantity.text for quantity in self.varied],
            {name: dict(others) for name, others in self.correlation.items()},
            list(recipes),
            # which numbers are floats, and which are arrays, is no part of them
            np.array([*self.axis.limits.stroke, self.axis.limits.speed, self.axis.limits.acceleration], float),
            (float(self.axis.sampling.rate), self.axis.sampling.plant_steps),
            as_arrays((self.axis.drive, dict(self.controllers))),
            {name: np.array(_signals(motion), float) for name, motion in self.motions.items()},
        )


def _signals(motion: Motion) -> tuple[np.ndarray, ...]:
    """All that a loop takes of a motion: velocity and acceleration drive the feed-forward."""
    return motion.time, motion.position, motion.velocity, motion.acceleration


def _outcome(costs: Costs, samples: np.ndarray, period: float) -> SweepCosts:
    """A machine diverged that did not stay to the end of its own cycle."""
    return SweepCosts(costs, np.where(costs.steps_finite >= samples, np.nan, costs.steps_finite * period))
